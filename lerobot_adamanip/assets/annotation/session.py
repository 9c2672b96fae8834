"""Editing session of an annotation: loads the best available one, applies changes, and autosaves them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lerobot_adamanip.assets.annotation.file import (
    ANNOTATION_NAME,
    Annotation,
    JointChoice,
    PartChoice,
    read_annotation,
    save_annotation,
)
from lerobot_adamanip.assets.annotation.proposal import propose, propose_part
from lerobot_adamanip.assets.convert import assemble_object, check_joint_roles
from lerobot_adamanip.assets.kinematics import Posed, object_frame, posed
from lerobot_adamanip.assets.roles import JointRole, PartRole
from lerobot_adamanip.assets.upstream import default_choice, upstream_annotation
from lerobot_adamanip.assets.urdf import URDF_NAME, Urdf, read_urdf
from lerobot_adamanip.objects.base import TWO_FINGERS, ArticulatedObject, Pose, any_roll
from lerobot_adamanip.util.errors import ConfigurationError

DRAFT_NAME = "adamanip.draft.json"
"""Unsaved changes; removed by saving."""


class Draft:
    """Annotation of one folder during editing. Grasps are in the object frame, with joints at rest.

    Attributes:
        folder, path: folder of the object, and path of its ``adamanip.json``.
        annotation: present state.
        origin: its source, in words.
        changed: whether it has changes that no file contains yet.
    """

    def __init__(self, folder: Path, category: str) -> None:
        """Reads the folder.

        Raises:
            ConfigurationError: the URDF or a mesh is unreadable. No file is overwritten.
        """
        self.folder, self.category, self.path = folder, category, folder / ANNOTATION_NAME
        self.urdf: Urdf = read_urdf(folder / URDF_NAME)
        self.annotation, self.origin = self._best_there_is()
        self.changed = False
        self._place()

    def _best_there_is(self) -> tuple[Annotation, str]:
        note = ""
        for name, origin in ((DRAFT_NAME, "changes that were not saved"), (ANNOTATION_NAME, "saved annotation")):
            if not (self.folder / name).is_file():
                continue
            if (annotation := self._usable(name)) is not None:
                return annotation, origin
            note += f"; {name} does not fit, and saving replaces it"
        try:
            return upstream_annotation(self.urdf, self.category), f"AdaManip's annotated points{note}"
        except ConfigurationError:
            return propose(self.urdf, self.category), f"proposed from bounding boxes{note}"

    def _usable(self, name: str) -> Annotation | None:
        """Returns a stored annotation; None if it is damaged, or names joints or links that the object lacks."""
        try:
            annotation = read_annotation(self.folder / name, self.category)
            check_joint_roles(self.urdf, annotation)
        except ConfigurationError:
            return None
        return annotation if all(part.link in self.urdf.links for part in annotation.parts.values()) else None

    def _place(self) -> None:
        """Computes the link poses, and converts grasps from link frames to the object frame."""
        self.posed: Posed = posed(self.urdf, self.annotation)
        frame = object_frame(self.posed, self.annotation)

        def in_object(part: PartChoice) -> PartChoice:
            if part.frame == "object":
                return part
            return replace(part, grasp=np.linalg.inv(frame) @ self.posed.poses[part.link] @ part.grasp, frame="object")

        parts = {name: in_object(part) for name, part in self.annotation.parts.items()}
        self.annotation = replace(self.annotation, parts=parts, object_in_urdf=frame)

    def object(self) -> ArticulatedObject:
        """Returns the object without collision shapes; raises `ConfigurationError` if the joints conflict."""
        return assemble_object(self.urdf, self.annotation, self.posed, solid=False, checked=False)

    def problem(self) -> str:
        """Returns the problem that makes the annotation unusable; empty if there is none."""
        try:
            self._check()
        except ConfigurationError as error:
            return str(error)
        return ""

    def _check(self) -> None:
        assemble_object(self.urdf, self.annotation, self.posed, solid=False)

    def set_joint(self, role: JointRole, joint: str) -> None:
        """Sets the joint of a role, with the limits from the URDF."""
        chosen = next(each for each in self.urdf.moving if each.name == joint)
        self._set_choice(role.name, default_choice(role, chosen))

    def set_range(self, role: str, rest: float, opened: float) -> None:
        """Sets the rest and open positions of a joint, in the URDF's units."""
        if rest == opened:
            what, allowed = f"The joint {role} would not move.", "an open position other than that at rest"
            raise ConfigurationError(what, got=f"rest and open {rest:g}", allowed=allowed, hint="another open position")
        self._set_choice(role, JointChoice(self.annotation.joints[role].joint, rest, opened))

    def _set_choice(self, role: str, choice: JointChoice) -> None:
        before = self.annotation
        self.annotation = replace(before, joints={**before.joints, role: choice})
        try:
            self._place()
            self.object()
        except ConfigurationError:
            self.annotation = before
            self._place()
            raise
        self.changed = True

    def set_grasp(self, part: str, grasp: Pose) -> None:
        """Sets the grasp (4, 4) of a part, in the object frame with joints at rest."""
        self._set_part(part, replace(self.annotation.parts[part], grasp=grasp))

    def set_link(self, part: PartRole, link: str) -> None:
        """Sets the link of a part, and proposes a grasp on it."""
        assert self.annotation.object_in_urdf is not None
        frame = self.annotation.object_in_urdf
        self._set_part(part.name, propose_part(self.posed, self.annotation, part, frame, link))

    def set_round(self, part: str, any_side: bool) -> None:
        """Sets whether a part can be held from every side of the approach."""
        self._set_part(part, replace(self.annotation.parts[part], rolls=any_roll() if any_side else TWO_FINGERS))

    def _set_part(self, name: str, part: PartChoice) -> None:
        self.annotation = replace(self.annotation, parts={**self.annotation.parts, name: part})
        self.changed = True

    def set_scale(self, scale: float) -> None:
        """Sets the metres per unit of the URDF; scales all positions."""
        grown = np.ones((4, 4))
        grown[:3, 3] = scale / self.annotation.scale
        parts = {k: replace(part, grasp=part.grasp * grown) for k, part in self.annotation.parts.items()}
        assert self.annotation.object_in_urdf is not None
        frame = self.annotation.object_in_urdf * grown
        self.annotation = replace(self.annotation, parts=parts, scale=scale, object_in_urdf=frame)
        self._place()
        self.changed = True

    def autosave(self) -> None:
        """Keeps unsaved changes in a draft file beside the annotation."""
        if self.changed:
            save_annotation(self.folder / DRAFT_NAME, self.annotation)
            self.changed = False

    def save(self) -> None:
        """Writes ``adamanip.json`` and removes the draft.

        Raises:
            ConfigurationError: the object is unusable with it; the changes are kept as a draft.
        """
        try:
            self._check()
        except ConfigurationError:
            self.autosave()
            raise
        save_annotation(self.path, self.annotation)
        (self.folder / DRAFT_NAME).unlink(missing_ok=True)
        self.changed, self.origin = False, "saved annotation"
