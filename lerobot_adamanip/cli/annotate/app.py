"""The annotation tool's page: joints and parts at the side, the object and a gripper to drag in the middle."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lerobot_adamanip.assets.annotation.session import Draft
from lerobot_adamanip.assets.roles import ROLES, JointRole
from lerobot_adamanip.cli.annotate.view import ObjectView, add_gripper, place
from lerobot_adamanip.contract.rotations import matrix_from_quaternion, transform
from lerobot_adamanip.objects.base import ArticulatedObject, Pose
from lerobot_adamanip.util.errors import AdaManipError

HELP = """**The grey gripper shows where the part is held.** Drag its arrows and rings. It approaches along its blue
arrow and closes along its green one. Move the joints to see whether it stays with the part. Front: towards +x (red
axis)."""


class AnnotationApp:
    """One page on one or more folders; every change goes to a draft, Save writes ``adamanip.json``.

    Args:
        server: viser's.
        folders: of objects.
        category: of all of them.
    """

    def __init__(self, server: Any, folders: Sequence[Path], category: str) -> None:
        self._server, self._folders, self._roles = server, list(folders), ROLES[category]
        self._category, self._lock = category, threading.RLock()
        self._panel: list[Any] = []
        self._view: ObjectView | None = None
        self._draft: Draft | None = None
        self._positions: dict[str, float] = {}
        _scenery(server)
        names = [folder.name for folder in self._folders]
        self._chooser = server.gui.add_dropdown("Object", names, initial_value=names[0])
        by_hand(self._chooser, lambda: self._open(names.index(self._chooser.value)))
        self._save = server.gui.add_button("Save", color="green")
        self._save.on_click(lambda _: self._saved())
        self._status = server.gui.add_markdown("")
        self._open(0)

    def autosave(self) -> None:
        """Writes changes to the draft, if there are any."""
        with self._lock:
            if self._draft is not None and self._draft.changed:
                self._guarded(self._draft.autosave)

    # One object ----------------------------------------------------------------------------------------------------

    def _open(self, number: int) -> None:
        with self._lock:
            self.autosave()
            self._clear()
            if not self._guarded(lambda: self._load(self._folders[number])) or self._draft is None:
                return
            self._tell(f"{self._folders[number].name}: {self._draft.origin}.")
            self._show_object()
            self._add_panel()
            _aim(self._server, self._view)

    def _load(self, folder: Path) -> None:
        self._draft = Draft(folder, self._category)
        self._draft.object()

    def _clear(self) -> None:
        for handle in self._panel:
            handle.remove()
        if self._view is not None:
            self._view.remove()
        self._panel, self._view, self._draft, self._positions = [], None, None, {}

    def _show_object(self) -> None:
        assert self._draft is not None
        if self._view is not None:
            self._view.remove()
        self._view = ObjectView(self._server, self._draft.object())
        self._view.move(self._positions)

    def _saved(self) -> None:
        with self._lock:
            if self._draft is None:
                return
            try:
                path = self._draft.save()
            except (AdaManipError, OSError) as error:
                self._tell(f"**Not saved**, kept as a draft:\n```\n{error}\n```")
            else:
                self._tell(f"**Saved** {path.parent.name}/{path.name}.")

    # The panel -----------------------------------------------------------------------------------------------------

    def _add_panel(self) -> None:
        assert self._draft is not None
        gui, draft = self._server.gui, self._draft
        scale = gui.add_number("Metres per unit", draft.annotation.scale, min=0.001, max=1000.0, step=0.001)
        by_hand(scale, lambda: self._change(lambda: draft.set_scale(float(scale.value)), redraw=True))
        self._panel += [scale]
        for role in self._roles.joints:
            self._add_joint(role, "opens" if role is self._roles.final else "releases")
        self._add_parts()
        self._panel.append(gui.add_markdown(HELP))

    def _add_joint(self, role: JointRole, what: str) -> None:
        assert self._draft is not None
        gui, draft = self._server.gui, self._draft
        folder = gui.add_folder(f"Joint {role.name} ({what})")
        self._panel.append(folder)
        choice, names = draft.annotation.joints[role.name], [joint.name for joint in draft.urdf.moving]
        with folder:
            chosen = gui.add_dropdown("URDF joint", names, initial_value=choice.joint)
            rest = gui.add_number("At rest", choice.rest, step=0.001)
            opened = gui.add_number("Open", choice.open, step=0.001)
            slider = gui.add_slider(f"Move {role.name}", -1.0 if role.either_way else 0.0, 1.0, 0.01, 0.0)

        def show() -> None:
            now = draft.annotation.joints[role.name]
            chosen.value, rest.value, opened.value = now.joint, now.rest, now.open

        def choose() -> None:
            self._change(lambda: draft.set_joint(role, chosen.value), redraw=True)
            show()

        def limit() -> None:
            self._change(lambda: draft.set_range(role.name, float(rest.value), float(opened.value)), redraw=True)

        by_hand(chosen, choose)
        by_hand(rest, limit)
        by_hand(opened, limit)
        by_hand(slider, lambda: self._move(role.name, float(slider.value)))

    def _move(self, joint: str, fraction: float) -> None:
        with self._lock:
            if self._view is not None:
                self._positions[joint] = fraction * self._view.obj.joint(joint).limits[1]
                self._view.move(self._positions)
                self._place_gizmo()

    def _add_parts(self) -> None:
        assert self._draft is not None
        gui, draft = self._server.gui, self._draft
        folder = gui.add_folder("Part")
        parts = {part.name: part for part in self._roles.parts}
        with folder:
            self._part = gui.add_dropdown("Edit", list(parts), initial_value=next(iter(parts)))
            link = gui.add_dropdown("On link", list(draft.urdf.links))
            sides = gui.add_checkbox("Round: hold from any side", False)
            again = gui.add_button("Propose again")
        self._gizmo = self._server.scene.add_transform_controls("/grasp", scale=0.12, depth_test=False)
        self._gripper = add_gripper(self._server, "/grasp/gripper")
        self._panel += [folder, self._gripper, self._gizmo]

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
        by_hand(self._gizmo, self._dragged)

    # The gripper ---------------------------------------------------------------------------------------------------

    def _carried(self) -> Pose:
        """The motion (4, 4) that the joints, as they stand, give to what holds the part."""
        assert self._draft is not None
        part = self._draft.object().part(self._part.value)
        return replace(part, grasp=np.eye(4)).moved(self._positions)

    def _place_gizmo(self) -> None:
        assert self._draft is not None
        place(self._gizmo, self._carried() @ self._draft.annotation.parts[self._part.value].grasp)

    def _dragged(self) -> None:
        with self._lock:
            if self._draft is None:
                return
            shown = transform(np.asarray(self._gizmo.position), matrix_from_quaternion(np.asarray(self._gizmo.wxyz)))
            self._draft.set_grasp(self._part.value, np.linalg.inv(self._carried()) @ shown)
            self._tell("Not saved yet (a draft is kept).")

    # ----------------------------------------------------------------------------------------------------------------

    def _change(self, change: Callable[[], None], *, redraw: bool = False) -> bool:
        with self._lock:
            done = self._guarded(change)
            if done:
                if redraw:
                    self._show_object()
                    self._place_gizmo()
                self._tell("Not saved yet (a draft is kept).")
            return done

    def _guarded(self, action: Callable[[], object]) -> bool:
        try:
            action()
        except (AdaManipError, OSError) as error:
            self._tell(f"```\n{error}\n```")
            return False
        return True

    def _tell(self, text: str) -> None:
        self._status.content = text


def by_hand(handle: Any, action: Callable[[], object]) -> None:
    """Calls ``action`` when somebody changes a control on the page, not when the program does."""
    handle.on_update(lambda event: action() if event.client is not None else None)


def show(server: Any, obj: ArticulatedObject) -> None:
    """Shows an object that cannot be changed: sliders, and a gripper at each part."""
    _scenery(server)
    view, positions = ObjectView(server, obj), dict[str, float]()
    grippers = {part.name: add_gripper(server, f"/grasp_{part.name}") for part in obj.parts}
    server.gui.add_markdown(f"**{obj.object_id}**: {obj.description}")

    def move(name: str, value: float) -> None:
        positions[name] = value
        view.move(positions)
        for part in obj.parts:
            place(grippers[part.name], part.moved(positions))

    for link in obj.links:
        if link.joint is not None and link.joint.kind != "fixed":
            _slide(server, link.joint.name, link.joint.limits, move)
    for part in obj.parts:
        place(grippers[part.name], part.grasp)
    _aim(server, view)


def _slide(server: Any, name: str, limits: tuple[float, float], move: Callable[[str, float], None]) -> None:
    slider = server.gui.add_slider(f"Move {name}", limits[0], limits[1], (limits[1] - limits[0]) / 200, 0.0)
    by_hand(slider, lambda: move(name, float(slider.value)))


def _scenery(server: Any) -> None:
    server.scene.set_up_direction("+z")
    server.scene.configure_default_lights(cast_shadow=False)  # shadows are too much for a machine without a GPU
    server.scene.add_grid("/floor", width=4.0, height=4.0, cell_size=0.1, section_size=0.5)
    server.scene.add_frame("/axes", axes_length=0.15, axes_radius=0.003)
    server.gui.configure_theme(control_width="medium", show_logo=False)
    server.gui.main_panel.dock_right()


def _aim(server: Any, view: ObjectView | None) -> None:
    """Looks at the object from the front, the side and above."""
    if view is None:
        return
    width, depth, height = view.obj.size
    far = 1.25 * float(np.linalg.norm((width, depth, height))) + 0.2
    target = np.array([0.0, 0.0, height / 2])
    eye = target + far * np.array([0.9, -0.3, 0.35])
    server.initial_camera.position, server.initial_camera.look_at = eye, target
    for client in server.get_clients().values():
        client.camera.position, client.camera.look_at = eye, target
