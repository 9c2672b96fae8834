"""What counts as a push, on contacts that are a few numbers: no simulator."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.episode.tries import Push
from lerobot_env_adamanip.sim.contacts import PUSH_LAG, PUSH_TURN_LAG, ArmContacts

STEP = 0.005
AWAY = transform((0.0, 0.0, 0.0))


class Body:
    """A link, its body and its entity in one."""

    def __init__(self, name: str, joint: Any = None) -> None:
        self.name, self.entity, self.joint, self.parent = name, self, joint, None


class Joint:
    """Moves along x, or turns about it through the origin."""

    dof = 1
    global_pose = SimpleNamespace(to_transformation_matrix=lambda: np.eye(4, dtype=np.float32))

    def __init__(self, kind: str) -> None:
        self.type, self.name = kind, "scene-0-thing_part"


class Scene:
    """A finger at a part whose joint stands at 0 and may go from ``lower`` to 1."""

    timestep = STEP

    def __init__(
        self, kind: str = "prismatic", place: tuple[float, float, float] = (0.0, 0.0, 0.0), lower: float = 0.0
    ) -> None:
        self.finger, self.part, self.place = Body("panda_leftfinger"), Body("part", Joint(kind)), place
        self.contacts: list[Any] = []
        arm: Any = SimpleNamespace(links=[self.finger])
        target: Any = SimpleNamespace(
            links=[self.part], active_joints=[self.part.joint], get_qpos=lambda: np.array([0.0])
        )
        joint = SimpleNamespace(name="part", limits=(lower, 1.0))
        self.made = ArmContacts(self, arm, target, SimpleNamespace(links=[SimpleNamespace(joint=joint)]))  # type: ignore[arg-type]

    def get_contacts(self) -> list[Any]:
        return self.contacts

    def press(self, *force: float, hand_first: bool = False) -> None:
        """The finger acts on the part with a force [N]."""
        bodies = [self.finger, self.part] if hand_first else [self.part, self.finger]
        impulse = np.array(force) * STEP * (-1.0 if hand_first else 1.0)
        point = SimpleNamespace(impulse=impulse, position=np.array(self.place))
        self.contacts = [SimpleNamespace(bodies=bodies, points=[point])]

    def grip(self, force: float) -> None:
        """Two fingers clamp the part, across its motion; PhysX reports no friction."""
        self.press(0.0, force, 0.0)
        self.contacts[0].points.append(
            SimpleNamespace(impulse=np.array([0.0, -force * STEP, 0.0]), position=self.place)
        )

    def goes(self, *ways: Any, actual: Any = AWAY) -> Push | None:
        """Sends the hand to one pose after the other; returns its push at the last."""
        pushes: dict[str, Push] = {}
        for way in ways:
            pushes = self.made.pushes(way if np.ndim(way) == 2 else transform(way), actual)
        return pushes.get("part")


def means(push: Push | None, direction: int = 1) -> bool:
    return push is not None and push.is_meant and push.direction == direction


@pytest.mark.parametrize("hand_first", [False, True])
def test_a_hand_that_is_sent_on_where_the_part_moves_pushes_it(hand_first: bool) -> None:
    scene = Scene()
    scene.press(5.0, 0.0, 0.0, hand_first=hand_first)
    assert not means(scene.goes((0.0, 0.0, 0.0), (0.002, 0.0, 0.0)))  # a touch
    assert means(scene.goes((0.004, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("force", "goal"),
    [
        ((0.5, 0.0, 0.0), (0.010, 0.0, 0.0)),  # a brush
        ((0.0, 50.0, 0.0), (0.0, 0.010, 0.0)),  # leans on it where it does not move
        ((-5.0, 0.0, 0.0), (-0.010, 0.0, 0.0)),  # against the end that it stands at
        ((5.0, 50.0, 0.0), (0.004, 0.030, 0.0)),  # on its way past it
        ((5.0, 0.0, 0.0), (-0.010, 0.0, 0.0)),  # turned aside while it is drawn back
    ],
)
def test_what_is_no_push(force: tuple[float, ...], goal: tuple[float, ...]) -> None:
    scene = Scene()
    scene.press(*force)
    push = scene.goes((0.0, 0.0, 0.0), goal)
    assert push is not None, "the hand touches the part"
    assert not push.is_meant


def test_a_hand_in_the_air_does_nothing() -> None:
    assert Scene().goes((0.0, 0.0, 0.0), (0.010, 0.0, 0.0)) is None


def test_a_part_is_pushed_down_as_far_as_its_range_goes() -> None:
    scene = Scene(lower=-0.5)
    scene.press(-5.0, 0.0, 0.0)
    assert means(scene.goes((0.0, 0.0, 0.0), (-0.010, 0.0, 0.0)), -1)


def test_a_gripped_part_is_pulled_by_the_lag_of_the_hand() -> None:
    """Friction transmits the pull: no contact force along the motion is reported."""
    scene = Scene()
    scene.grip(40.0)
    assert means(scene.goes((0.0, 0.0, 0.0), (0.010, 0.0, 0.0)))
    scene.grip(0.4)
    assert not means(scene.goes((0.0, 0.0, 0.0), (0.010, 0.0, 0.0)))


def test_a_hand_that_slides_along_is_not_held_back() -> None:
    scene = Scene()
    scene.press(5.0, 0.0, 0.0)
    there = transform((0.010, 0.0, 0.0))
    assert not means(scene.goes((0.0, 0.0, 0.0), there, actual=transform((0.010 - 0.9 * PUSH_LAG, 0.0, 0.0))))


def test_a_hand_that_is_deflected_means_no_push() -> None:
    """The fingers close beside the middle and shift the hand, whose target stands still."""
    scene = Scene()
    scene.grip(40.0)
    assert not means(scene.goes((0.010, 0.0, 0.0), actual=transform((0.010, 0.0, 0.0))))
    assert not means(scene.goes((0.010, 0.0, 0.0)))


def test_a_part_turns_by_a_hand_that_turns_about_its_axis() -> None:
    scene = Scene("revolute", place=(0.0, 0.02, 0.0))  # 0.1 rad are 2 mm here
    scene.press(0.0, 0.0, 5.0)
    turned = [transform((0.0, 0.0, 0.0), rotation_about((1.0, 0.0, 0.0), angle)) for angle in (0.0, 0.007, 0.1)]
    assert not means(scene.goes(turned[0], turned[1]))
    assert means(scene.goes(turned[2]))
    follows = transform((0.0, 0.0, 0.0), rotation_about((1.0, 0.0, 0.0), 0.1 - 0.9 * PUSH_TURN_LAG))
    assert not means(scene.goes(turned[2], actual=follows))


def test_a_hand_that_lifts_and_hardly_turns_does_not_turn() -> None:
    scene = Scene("revolute", place=(0.0, 0.01, 0.0))
    scene.grip(40.0)
    assert not means(scene.goes(AWAY, transform((0.03, 0.0, 0.0), rotation_about((1.0, 0.0, 0.0), 0.02))))
