"""What rendering makes of a job: the plan, the tiles, the results.

Job: the files of a job beside its record and its events.
Invariant: plan and tiles are created once and never replaced; results are moved into place whole.
"""
# os calls where they are measurably cheaper (a tile costs 0.15 ms)
# ruff: noqa: PTH123, PTH208

import json
import os
import secrets
import shutil
from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from worker import files
from worker.contract import RESULT_NAMES
from worker.errors import BadNameError, JobNotFoundError
from worker.records import check_job_id


class Products:
    """Plans, tiles and results in the folders of jobs.

    Parameters
    ----------
    jobs
        Folder of the jobs' folders; must exist.
    temporary
        Folder on the same filesystem for files on their way.
    """

    def __init__(self, jobs: Path, temporary: Path) -> None:
        self._jobs = jobs
        self.temporary = temporary

    def job_dir(self, job_id: str) -> Path:
        """Return the folder of a job, existing or not; `BadNameError` if the id is none."""
        return self._jobs / check_job_id(job_id)

    def write_plan(self, job_id: str, plan: Mapping[str, Any]) -> bool:
        """Write the plan once; False if there is one. Not fsynced: what it says can be found out again."""
        path = self.job_dir(job_id) / "plan.json"
        try:
            return files.create(path, json.dumps(plan, indent=1).encode(), self.temporary, durable=False)
        except FileNotFoundError:
            raise JobNotFoundError(f"no job {job_id}") from None

    def read_plan(self, job_id: str) -> dict[str, Any] | None:
        """Return the plan, or None where there is none (or one that a power failure damaged)."""
        try:
            plan: dict[str, Any] = json.loads(self._read(job_id, "plan.json"))
        except (FileNotFoundError, ValueError):
            return None
        return plan

    def tile_path(self, job_id: str, tile: int, pass_index: int = 0) -> Path:
        """Return the file of a tile, existing or not."""
        return self.job_dir(job_id) / "tiles" / f"{int(pass_index)}-{int(tile)}"

    def write_tile(self, job_id: str, tile: int, data: bytes, pass_index: int = 0) -> bool:
        """Write a film tile if it is not there; True if this call did.

        Not fsynced: a tile lost in a power failure is missed by the steward, a damaged one is found by its checksum.
        """
        path = self.tile_path(job_id, tile, pass_index)
        try:
            return files.create(path, data, self.temporary, durable=False)
        except FileNotFoundError:
            raise JobNotFoundError(f"no job {job_id}") from None

    def read_tile(self, job_id: str, tile: int, pass_index: int = 0) -> bytes:
        """Return a film tile's bytes; FileNotFoundError where there is none."""
        return self.tile_path(job_id, tile, pass_index).read_bytes()

    def done_tiles(self, job_id: str, pass_index: int = 0) -> list[int]:
        """Return the indices of the tiles that are written, ascending."""
        prefix = f"{int(pass_index)}-"
        try:
            names = os.listdir(self.job_dir(job_id) / "tiles")
        except FileNotFoundError:
            return []
        return sorted(int(name[len(prefix) :]) for name in names if name.startswith(prefix))

    def delete_tiles(self, job_id: str) -> None:
        """Remove the tiles of a job that has ended."""
        grave = self.temporary / f"tiles-{job_id}-{secrets.token_hex(4)}"
        with suppress(FileNotFoundError):  # renamed first: a late worker finds no folder instead of a half-empty one
            (self.job_dir(job_id) / "tiles").rename(grave)
            shutil.rmtree(grave, ignore_errors=True)

    def assembly_folder(self, job_id: str) -> Path:
        """Make a working folder for the results of a job, in ``tmp``."""
        folder = self.temporary / f"assembly-{check_job_id(job_id)}-{secrets.token_hex(4)}"
        with files.full_is_clear():
            folder.mkdir()
        return folder

    def delete_assemblies(self, job_id: str) -> None:
        """Remove the working folders of a job that are in nobody's use any more."""
        for folder in self.temporary.glob(f"assembly-{check_job_id(job_id)}-*"):
            shutil.rmtree(folder, ignore_errors=True)

    def result_path(self, job_id: str, name: str) -> Path:
        """Return the file of a result, existing or not; `BadNameError` for any name but the four."""
        if name not in RESULT_NAMES:
            raise BadNameError(f"no result {name!r}")
        return self.job_dir(job_id) / name

    def has_result(self, job_id: str, name: str) -> bool:
        """Whether this result is there."""
        return self.result_path(job_id, name).is_file()

    def commit_result(self, job_id: str, parts: Mapping[str, Path], *, synced: Collection[str] = ()) -> None:
        """Move finished files of results into place, all of them durable; existing ones are replaced by equal bytes.

        Parameters
        ----------
        job_id
            Whose.
        parts
            Name of the result -> finished file on the same filesystem.
        synced
            Names of those that were written through to the disk already.
        """
        files.fsync_files([path for name, path in parts.items() if name not in synced])
        with files.full_is_clear():
            for name, path in parts.items():
                path.replace(self.result_path(job_id, name))
            files.fsync_folder(self.job_dir(job_id))

    def _read(self, job_id: str, name: str) -> bytes:
        folder = self.job_dir(job_id)
        try:
            with open(folder / name, "rb") as file:
                return file.read()
        except FileNotFoundError:
            if not folder.is_dir():
                raise JobNotFoundError(f"no job {job_id}") from None
            raise
