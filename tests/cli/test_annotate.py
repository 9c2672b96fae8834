"""`adamanip annotate` without a browser: what it proposes, what it keeps, what it says."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.assets import load_object
from lerobot_adamanip.assets.annotation.file import ANNOTATION_NAME
from lerobot_adamanip.assets.annotation.session import DRAFT_NAME, Draft
from lerobot_adamanip.assets.roles import ROLES
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.util.errors import ConfigurationError

sys.path.insert(0, str(Path(__file__).parents[1] / "objects"))
from asset_folders import adamanip_bottle, adamanip_safe, annotated, partnet_safe, safe_annotation

DOOR, KNOB = ROLES["safe"].joints


def test_a_proposal_is_usable_as_it_stands(tmp_path: Path) -> None:
    draft = Draft(partnet_safe(tmp_path / "101564"), "safe")
    assert "proposed" in draft.origin
    assert {name: choice.joint for name, choice in draft.annotation.joints.items()} == {
        "door": "joint_0",
        "knob": "joint_2",
    }
    assert draft.problem() == ""
    obj = draft.object()
    assert obj.size[2] == pytest.approx(0.42, abs=0.03), "a typical size: PartNet-Mobility has no metres"
    # The handle is the mesh of the door that sticks out, not the door; it is upright, so the fingers close across.
    handle = obj.part("handle").grasp
    np.testing.assert_allclose(handle[:3, 1], (0, 1, 0), atol=1e-9)
    door_edge = obj.joint("door").origin[1]
    assert abs(handle[1, 3] - door_edge) > 0.2
    draft.save()
    assert load_object(draft.folder, "safe").part("handle").grasp == pytest.approx(handle)


@pytest.mark.parametrize(("make", "category"), [(adamanip_safe, "safe"), (adamanip_bottle, "bottle")])
def test_annotated_points_are_where_it_starts(tmp_path: Path, make: Any, category: str) -> None:
    folder = make(tmp_path / "x1")
    draft = Draft(folder, category)
    assert "AdaManip" in draft.origin
    before = load_object(folder, category)
    draft.save()
    after = load_object(folder, category)
    for part in before.parts:
        np.testing.assert_allclose(after.part(part.name).grasp, part.grasp, atol=1e-9)
    assert [link.joint for link in after.links] == [link.joint for link in before.links]


def test_a_joint_that_would_not_move_is_refused_and_locks_no_draft(tmp_path: Path) -> None:
    folder = partnet_safe(tmp_path / "101564")
    draft = Draft(folder, "safe")
    with pytest.raises(ConfigurationError, match="would not move"):
        draft.set_range("door", 0.5, 0.5)
    draft.autosave()
    Draft(folder, "safe")


@pytest.mark.parametrize(
    "changes",
    [
        None,
        {"version": 2},
        {"category": "door"},
        {"parts": {}},
        {
            "joints": {
                "door": {"joint": "joint_0", "rest": 0, "open": 1},
                "knob": {"joint": "joint_0", "rest": 0, "open": 1},
            }
        },
        {
            "joints": {
                "door": {"joint": "gone", "rest": 0, "open": 1},
                "knob": {"joint": "joint_2", "rest": 0, "open": 1},
            }
        },
        {"parts": {name: {**part, "link": "gone"} for name, part in safe_annotation()["parts"].items()}},
    ],
)
def test_a_damaged_annotation_is_proposed_anew_and_replaced_by_saving(
    tmp_path: Path, changes: dict[str, Any] | None
) -> None:
    folder = annotated(tmp_path / "x1", **(changes or {}))
    if changes is None:
        (folder / ANNOTATION_NAME).write_text("{ half of")
    damaged = (folder / ANNOTATION_NAME).read_bytes()
    draft = Draft(folder, "safe")
    assert draft.origin == f"proposed from bounding boxes; {ANNOTATION_NAME} does not fit, and saving replaces it"
    assert (folder / ANNOTATION_NAME).read_bytes() == damaged
    draft.save()
    assert Draft(folder, "safe").origin == "saved annotation"


def test_work_is_never_lost(tmp_path: Path) -> None:
    folder = partnet_safe(tmp_path / "101564")
    draft = Draft(folder, "safe")
    grasp = draft.annotation.parts["knob"].grasp @ transform((0.0, 0.01, 0.0), rotation_about((0, 0, 1), 0.3))
    draft.set_grasp("knob", grasp)
    draft.set_round("knob", True)
    draft.set_range("door", 0.0, 1.2)
    draft.autosave()  # and the program is killed
    again = Draft(folder, "safe")
    assert "not saved" in again.origin
    np.testing.assert_allclose(again.annotation.parts["knob"].grasp, grasp, atol=1e-12)
    assert len(again.annotation.parts["knob"].rolls) > 2
    again.save()
    assert not (folder / DRAFT_NAME).exists()
    assert Draft(folder, "safe").origin == "saved annotation"
    assert load_object(folder, "safe").joint("door").limits == (0.0, 1.2)


def test_what_cannot_be_used_is_kept_but_not_saved(tmp_path: Path) -> None:
    folder = partnet_safe(tmp_path / "101564")
    draft = Draft(folder, "safe")
    before = draft.annotation
    with pytest.raises(ConfigurationError, match="two of its own"):
        draft.set_joint(KNOB, "joint_0")
    assert draft.annotation.joints == before.joints, "joints that clash change nothing"
    draft.set_grasp("knob", transform((2.0, 0.0, 0.0)))
    assert "outside" in draft.problem()
    with pytest.raises(ConfigurationError, match="knob"):
        draft.save()
    assert not (folder / "adamanip.json").exists()
    assert (folder / DRAFT_NAME).exists()


def test_a_larger_scale_takes_the_grasps_along(tmp_path: Path) -> None:
    draft = Draft(partnet_safe(tmp_path / "101564"), "safe")
    before, at = draft.object(), draft.annotation.parts["handle"].grasp[:3, 3]
    draft.set_scale(2 * draft.annotation.scale)
    np.testing.assert_allclose(draft.annotation.parts["handle"].grasp[:3, 3], 2 * at)
    np.testing.assert_allclose(draft.object().size, 2 * np.asarray(before.size), rtol=1e-5)


@pytest.fixture
def server() -> Iterator[Any]:
    pytest.importorskip("viser")
    from lerobot_adamanip.cli.annotate.command import start_viser

    made = start_viser("127.0.0.1", 18080)
    yield made
    made.stop()


def test_a_dragged_gripper_moves_the_grasp_wherever_the_joints_stand(tmp_path: Path, server: Any) -> None:
    from lerobot_adamanip.cli.annotate.app import AnnotationApp

    app = AnnotationApp(server, [partnet_safe(tmp_path / "101564")], "safe")
    editor = app.editor
    assert editor is not None
    draft, before = editor.draft, np.array(editor.gizmo.position)
    grasp = draft.annotation.parts["handle"].grasp
    editor.move("door", 0.5)
    opened = draft.object().part("handle").moved({"door": 0.5 * draft.object().joint("door").limits[1]})
    np.testing.assert_allclose(editor.gizmo.position, opened[:3, 3], atol=1e-6)
    editor.dragged()  # dropped where it was
    np.testing.assert_allclose(draft.annotation.parts["handle"].grasp, grasp, atol=1e-6)
    editor.gizmo.position = np.asarray(editor.gizmo.position) + 0.01 * opened[:3, 2]  # towards the door that is open
    editor.dragged()
    editor.move("door", 0.0)
    np.testing.assert_allclose(np.asarray(editor.gizmo.position) - before, 0.01 * grasp[:3, 2], atol=1e-6)
    app.autosave()
    assert json.loads((tmp_path / "101564" / DRAFT_NAME).read_text())["category"] == "safe"
