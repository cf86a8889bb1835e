"""What tests of the farm share: small scenes, a context around the fake backend, and turns of steward and assembler."""

from pathlib import Path
from typing import Any

from tracer.scene import SceneDoc, parse_scene
from worker import contract, jobs
from worker.assembler import Assembler
from worker.context import WorkerContext
from worker.queue import Queue
from worker.settings import FarmSettings
from worker.steward import Steward
from worker.store import Store
from worker.testing import FakeBackend


def make_scene(title: str = "fake", width: int = 96, height: int = 64, *, samples: int = 2, **more: Any) -> SceneDoc:
    return parse_scene(
        {
            "version": 1,
            "name": title,
            "camera": {"type": "perspective", "fov_deg": 40},
            "image": {"width": width, "height": height, **more.pop("image", {})},
            "sampling": {"samples": samples, "seed": 7},
            **more,
        }
    )


class SmallFarm:
    """A farm without processes: the test takes each turn itself."""

    def __init__(self, folder: Path, queue: Queue) -> None:
        self.store = Store(folder / "store")
        self.queue = queue
        self.settings = FarmSettings(store=folder / "store", cache=folder / "cache", backend="fake")
        self.steward = Steward(self.store, queue)
        self.assembler = Assembler(self.store, queue, "assembler")
        self.steward.tick()

    def worker(self, name: str = "w0") -> WorkerContext:
        return WorkerContext(self.settings, name, self.store, self.queue, FakeBackend())

    def submit(self, title: str = "fake", *, tile_size: int = 16, **scene: Any) -> str:
        output = {"tile_size": tile_size}
        return jobs.submit(self.store, self.queue, make_scene(title, **scene), owner="me", output=output).job_id

    def drop_hints(self) -> None:
        self.queue.redis.delete(*(f"rq:queue:{name}" for name in contract.QUEUES))

    def state(self, job_id: str) -> str:
        return str(self.store.last_event(job_id).state)
