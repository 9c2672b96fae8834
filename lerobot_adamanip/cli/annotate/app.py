"""Page of the annotation tool: controls for joints and parts, and the object with a draggable gripper."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.assets.annotation.session import Draft
from lerobot_adamanip.assets.roles import ROLES, JointRole, PartRole
from lerobot_adamanip.cli.annotate.view import ObjectView, add_gripper, place
from lerobot_adamanip.contract.rotations import matrix_from_quaternion, transform
from lerobot_adamanip.objects.base import Pose
from lerobot_adamanip.util.errors import AdaManipError

HELP = """**The grey gripper shows where the part is held.** Drag its arrows and rings. It approaches along its blue
arrow and closes along its green one. Move the joints to see whether it stays with the part. Front: towards +x (red
axis)."""
UNSAVED = "Not saved yet (a draft is kept)."


class AnnotationApp:
    """Page for one or more folders. Every change goes to a draft; Save writes ``adamanip.json``.

    Args:
        server: viser server.
        folders: folders of the objects.
        category: category of all objects.
    """

    def __init__(self, server: Any, folders: Sequence[Path], category: str) -> None:
        self._server, self._category, self._lock = server, category, threading.RLock()
        self.editor: ObjectEditor | None = None
        _add_scenery(server)
        by_name = {folder.name: folder for folder in folders}
        chooser = server.gui.add_dropdown("Object", list(by_name), initial_value=folders[0].name)
        by_hand(chooser, lambda: self._open(by_name[chooser.value]))
        server.gui.add_button("Save", color="green").on_click(lambda _: self._save())
        self._status = server.gui.add_markdown("")
        self._open(folders[0])

    def autosave(self) -> None:
        """Writes changes to the draft, if any."""
        if (editor := self.editor) is not None and editor.draft.changed:
            self.attempt(editor.draft.autosave)

    def attempt(self, action: Callable[[], object], done: str = "", failed: str = "") -> bool:
        """Runs one action at a time and returns whether it succeeded. Shows ``done``, or ``failed`` with the reason.

        Both texts are Markdown. An empty ``done`` keeps the current text.
        """
        with self._lock:
            try:
                action()
            except (AdaManipError, OSError) as error:
                self._status.content = f"{failed}```\n{error}\n```"
                return False
            self._status.content = done or self._status.content
            return True

    def _open(self, folder: Path) -> None:
        self.autosave()
        self.attempt(lambda: self._load(folder))

    def _load(self, folder: Path) -> None:
        if self.editor is not None:
            self.editor.remove()
            self.editor = None
        draft = Draft(folder, self._category)
        self.editor = ObjectEditor(self._server, draft, self.attempt)
        self._status.content = f"{folder.name}: {draft.origin}."

    def _save(self) -> None:
        if self.editor is not None:
            draft = self.editor.draft
            saved = f"**Saved** {draft.path.parent.name}/{draft.path.name}."
            self.attempt(draft.save, saved, failed="**Not saved**, kept as a draft:\n")


class ObjectEditor:
    """One object on the page, with controls for its joints and parts, and a gripper at the edited part.

    Args:
        server: viser server.
        draft: annotation of the object. Raises `ConfigurationError` if the object is missing.
        attempt: see `AnnotationApp.attempt`.
    """

    def __init__(self, server: Any, draft: Draft, attempt: Callable[..., bool]) -> None:
        self.draft, self._server, self._attempt = draft, server, attempt
        self._positions: dict[str, float] = {}
        self._view = ObjectView(server, draft.object())
        roles = ROLES[draft.category]
        scale = server.gui.add_number("Metres per unit", draft.annotation.scale, min=0.001, max=1000.0, step=0.001)
        by_hand(scale, lambda: self._change(lambda: draft.set_scale(float(scale.value)), redraw=True))
        self._panel = [scale]
        for role, purpose in zip(roles.joints, ("opens", "releases"), strict=True):
            self._add_joint(role, purpose)
        self._add_parts({part.name: part for part in roles.parts})
        self._panel.append(server.gui.add_markdown(HELP))
        self._aim()

    def remove(self) -> None:
        """Removes the object and its controls from the page."""
        for handle in (*self._panel, self._view):
            handle.remove()

    def move(self, joint: str, fraction: float) -> None:
        """Moves a joint by a fraction of its range, and the gripper with it."""
        self._positions[joint] = fraction * self._view.obj.joint(joint).limits[1]
        self._view.move(self._positions)
        self._place_gizmo()

    def dragged(self) -> None:
        """Sets the part's grasp to the gripper's pose on the page."""

        def take() -> None:
            shown = transform(np.asarray(self.gizmo.position), matrix_from_quaternion(np.asarray(self.gizmo.wxyz)))
            self.draft.set_grasp(self._part.value, np.linalg.inv(self._carried()) @ shown)

        self._change(take)

    def _add_joint(self, role: JointRole, purpose: str) -> None:
        gui, draft = self._server.gui, self.draft
        folder = gui.add_folder(f"Joint {role.name} ({purpose})")
        self._panel.append(folder)
        choice, names = draft.annotation.joints[role.name], [joint.name for joint in draft.urdf.moving]
        with folder:
            chosen = gui.add_dropdown("URDF joint", names, initial_value=choice.joint)
            rest = gui.add_number("At rest", choice.rest, step=0.001)
            opened = gui.add_number("Open", choice.open, step=0.001)
            slider = gui.add_slider(f"Move {role.name}", -1.0 if role.either_way else 0.0, 1.0, 0.01, 0.0)

        def choose() -> None:
            self._change(lambda: draft.set_joint(role, chosen.value), redraw=True)
            now = draft.annotation.joints[role.name]
            chosen.value, rest.value, opened.value = now.joint, now.rest, now.open

        def limit() -> None:
            self._change(lambda: draft.set_range(role.name, float(rest.value), float(opened.value)), redraw=True)

        by_hand(chosen, choose)
        by_hand(rest, limit)
        by_hand(opened, limit)
        by_hand(slider, lambda: self._attempt(lambda: self.move(role.name, float(slider.value))))

    def _add_parts(self, parts: dict[str, PartRole]) -> None:
        gui, draft = self._server.gui, self.draft
        folder = gui.add_folder("Part")
        with folder:
            self._part = gui.add_dropdown("Edit", list(parts), initial_value=next(iter(parts)))
            link = gui.add_dropdown("On link", list(draft.urdf.links))
            sides = gui.add_checkbox("Round: hold from any side", False)
            again = gui.add_button("Propose again")
        self.gizmo = self._server.scene.add_transform_controls("/grasp", scale=0.12, depth_test=False)
        self._panel += [folder, add_gripper(self._server, "/grasp/gripper"), self.gizmo]

        def show() -> None:
            held = draft.annotation.parts[self._part.value]
            link.value, sides.value = held.link, len(held.rolls) > 2
            self._place_gizmo()

        def relink() -> None:
            self._change(lambda: draft.set_link(parts[self._part.value], link.value))
            show()

        show()
        by_hand(self._part, show)
        by_hand(link, relink)
        by_hand(sides, lambda: self._change(lambda: draft.set_round(self._part.value, bool(sides.value))))
        again.on_click(lambda _: relink())
        by_hand(self.gizmo, self.dragged)

    def _change(self, change: Callable[[], None], *, redraw: bool = False) -> None:
        if self._attempt(change, UNSAVED) and redraw:
            self._view.remove()
            self._view = ObjectView(self._server, self.draft.object())
            self._view.move(self._positions)
            self._place_gizmo()

    def _carried(self) -> Pose:
        """Returns the motion (4, 4) of the part's link at the current joint positions."""
        part = self.draft.object().part(self._part.value)
        return replace(part, grasp=np.eye(4)).moved(self._positions)

    def _place_gizmo(self) -> None:
        place(self.gizmo, self._carried() @ self.draft.annotation.parts[self._part.value].grasp)

    def _aim(self) -> None:
        """Points the camera at the object, from the front, the side and above."""
        far = 1.25 * float(np.linalg.norm(self._view.obj.size)) + 0.2
        target = np.array([0.0, 0.0, self._view.obj.size[2] / 2])
        eye = target + far * np.array([0.9, -0.3, 0.35])
        for camera in (self._server.initial_camera, *(client.camera for client in self._server.get_clients().values())):
            camera.position, camera.look_at = eye, target


def by_hand(handle: Any, action: Callable[[], object]) -> None:
    """Calls ``action`` when a user changes a control on the page, not when the program does."""
    handle.on_update(lambda event: action() if event.client is not None else None)


def _add_scenery(server: Any) -> None:
    server.scene.set_up_direction("+z")
    server.scene.configure_default_lights(cast_shadow=False)  # shadows are too slow without a GPU
    server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.1, section_size=0.5)
    server.scene.add_frame("/axes", axes_length=0.15, axes_radius=0.003)
    server.gui.configure_theme(control_width="medium", show_logo=False)
    server.gui.main_panel.dock_right()
