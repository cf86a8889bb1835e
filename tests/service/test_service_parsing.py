"""Large bodies are parsed in a process of their own."""

import json
from typing import Any

from service_farm import Farm, assert_problem, scene


def big_scene(n_rows: int) -> dict[str, Any]:
    rows = [[index * 0.001, 0.5, 1.25] for index in range(n_rows)]
    faces = [[index, (index + 1) % n_rows, (index + 2) % n_rows] for index in range(n_rows)]
    return scene(objects=[{"type": "mesh", "positions": rows, "faces": faces}])


def test_a_large_scene_is_parsed_in_a_process_of_its_own(farm: Farm) -> None:
    document = big_scene(30_000)
    assert len(json.dumps(document)) > 1_000_000
    answer = farm.post(document)
    assert answer.status_code == 202
    scene_json = farm.client.get(answer.json()["links"]["scene"])
    assert len(scene_json.json()["objects"][0]["faces"]) == 30_000
    document["objects"][0]["faces"][7] = [0, 1, 99_999]
    problem = assert_problem(farm.post(document), 422, "scene-invalid")
    assert [fault["pointer"] for fault in problem["errors"]] == ["/scene/objects/0/faces/7/2"]
