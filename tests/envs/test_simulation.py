"""One episode's simulation against a fake physics engine: work per tick, held joints, and what counts as a push."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.catalog import make_object
from lerobot_adamanip.contract.rotations import rotation_about, transform
from lerobot_adamanip.episode.tries import Push
from lerobot_adamanip.mechanisms import make_mechanism
from lerobot_env_adamanip.sim.simulation import (
    FREE_ITERATIONS,
    GRIP_TICKS,
    PUSH_LAG,
    PUSH_TURN_LAG,
    ArmContacts,
    Simulation,
    named_joints,
)

STEP = 0.005
AWAY = transform((0.0, 0.0, 0.0))
BOTH = frozenset(("door", "knob"))


class Joint:
    """A joint of the arm or the object, which moves along x, or turns about it through the origin."""

    dof, stiffness = 1, 1000.0
    global_pose = SimpleNamespace(to_transformation_matrix=lambda: np.eye(4, dtype=np.float32))

    def __init__(self, name: str, kind: str = "revolute") -> None:
        self.name, self.type = f"scene-0_safe_000_{name}", kind
        self.limits, self.writes = (-9.0, 9.0), 0
        self.drive_target, self.drive_velocity_target = [0.04], [0.0]

    def set_limits(self, limits: list[list[float]]) -> None:
        self.limits, self.writes = (limits[0][0], limits[0][1]), self.writes + 1

    def set_drive_target(self, position: float) -> None:
        self.drive_target = [position]

    def set_drive_velocity_target(self, velocity: float) -> None:
        self.drive_velocity_target = [velocity]


class Link:
    """A link, its body and its entity in one."""

    def __init__(self, name: str, joint: Any = None) -> None:
        self.name, self.entity, self.joint, self.parent, self.points = name, self, joint, None, ()


class World:
    """Physics engine, arm and safe. ``near``: physics step -> bodies of the contacts before it."""

    timestep = STEP

    def __init__(self, *, hold: bool = True, **hidden: Any) -> None:
        self.near: dict[int, list[Any]] = {}
        self.steps: list[int] = []
        self.joints = [Joint("door"), Joint("knob")]
        self.qpos, self.iterations = np.zeros(2), 40
        self.drives, self.links = [Joint(str(number)) for number in range(9)], [Link("finger"), Link("palm")]
        arm: Any = SimpleNamespace(
            active_joints=self.drives,
            links=self.links,
            get_qpos=lambda: np.zeros(9),
            get_qvel=lambda: np.zeros(9),
            get_solver_position_iterations=lambda: 40,
            set_solver_position_iterations=lambda iterations: setattr(self, "iterations", iterations),
        )
        safe: Any = SimpleNamespace(active_joints=self.joints, links=[], get_qpos=lambda: self.qpos)
        obj = make_object("safe_000")
        mechanism = make_mechanism(obj)
        kinematics: Any = SimpleNamespace(tcp_in_base=lambda _: np.eye(4))
        state = mechanism.draw(np.random.default_rng(0), {"locked": True, "direction": 1, **hidden})
        system: Any = self
        self.simulation = Simulation(
            system, arm, safe, kinematics=kinematics, obj=obj, mechanism=mechanism, state=state, steps=4, hold=hold
        )

    def get_contacts(self) -> list[Any]:
        return [SimpleNamespace(bodies=bodies, points=()) for bodies in self.near.get(len(self.steps), [])]

    def step(self) -> None:
        self.steps.append(self.iterations)

    def ticks(self, number: int, finger: float = 0.02) -> list[int]:
        """Iterations of each physics step."""
        for _ in range(number):
            self.simulation.tick(np.arange(7.0), np.ones(7), finger)
        return self.steps

    def follow(self, *at_rest: str) -> None:
        """One control step of ManiSkill's, after which these joints are at rest."""
        self.simulation.tries = SimpleNamespace(  # type: ignore[assignment]
            update=lambda *_: None, at_rest=lambda: frozenset(at_rest), tries=()
        )
        self.simulation.follow_control_step()

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        return {joint.name.rsplit("_", 1)[-1]: joint.limits for joint in self.joints}


# The tick -----------------------------------------------------------------------------------------------------------


def test_an_arm_that_touches_nothing_is_cheap_and_every_joint_is_sent() -> None:
    world = World()
    assert world.ticks(2) == [FREE_ITERATIONS] * 8
    assert world.simulation.ticks == 2
    assert [joint.drive_target[0] for joint in world.drives] == [*range(7), 0.02, 0.02]
    assert [joint.drive_velocity_target[0] for joint in world.drives[:7]] == [1.0] * 7


@pytest.mark.parametrize("side", [0, 1])
def test_from_the_first_contact_of_the_arm_on_a_tick_has_all_iterations(side: int) -> None:
    world = World()
    bodies = [Link("leaf"), Link("plinth")]
    world.near = {0: [bodies]}  # of others
    bodies_of_arm = [Link("leaf"), Link("leaf")]
    bodies_of_arm[side] = world.links[1]
    world.near[2] = [bodies_of_arm]
    assert world.ticks(2) == [FREE_ITERATIONS] * 2 + [40] * 2 + [FREE_ITERATIONS] * 4


def test_all_joints_are_held_while_fingers_close_and_a_moment_longer_if_the_arm_stays() -> None:
    world = World()

    def closes(finger: float, arm: float = 0.0) -> bool:
        for joint in world.drives[:7]:
            joint.set_drive_target(arm)
        for joint in world.drives[7:]:
            joint.set_drive_target(finger)
        world.follow()
        return world.simulation.held == BOTH

    assert not closes(0.04), "nothing is known of before"
    assert [closes(0.04 - 0.004 * k) for k in range(1, 4)] == [True] * 3
    assert [closes(0.028) for _ in range(GRIP_TICKS + 3)] == [True] * (GRIP_TICKS - 1) + [False] * 4
    assert closes(0.02)
    assert not closes(0.016, arm=0.01), "the arm moves"


# The mechanism ------------------------------------------------------------------------------------------------------


def test_limits_are_the_mechanisms_once_joints_are_released() -> None:
    world = World(knob_range=1.0)
    world.follow()
    assert world.limits == {"door": (0.0, 0.0), "knob": (0.0, 1.0)}
    world.qpos = np.array([0.0, 0.9])
    world.follow()
    assert world.limits["door"][1] > 0.5
    assert world.simulation.joint_positions() == {"door": 0.0, "knob": 0.9}


@pytest.mark.parametrize("locked", [True, False])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_held_joint_stays_whatever_is_hidden(locked: bool, direction: int) -> None:
    world = World(locked=locked, direction=direction)
    for drift in (1e-4, 0.3):
        world.qpos = np.array([drift, -drift])
        world.follow(*BOTH)
        assert world.limits == {"door": (0.0, 0.0), "knob": (0.0, 0.0)}
    assert [joint.writes for joint in world.joints] == [1, 1]


def test_one_joint_is_released_and_the_other_is_held_where_it_is() -> None:
    world = World(knob_range=1.0)
    world.follow("door")
    assert world.simulation.held == {"door"}
    assert world.limits == {"door": (0.0, 0.0), "knob": (0.0, 1.0)}
    world.qpos = np.array([0.0, 0.3])
    world.follow(*BOTH)
    world.qpos = np.array([0.001, 0.31])
    world.follow(*BOTH)
    assert world.limits == {"door": (0.0, 0.0), "knob": (0.3, 0.3)}


def test_limits_are_written_only_when_they_change() -> None:
    world = World(hold=False)
    for _ in range(5):
        world.follow(*BOTH)
    assert [joint.writes for joint in world.joints] == [1, 1]


def test_success_is_a_joint_beyond_its_goal() -> None:
    world = World(locked=False)
    assert not world.simulation.succeeded()
    world.qpos = np.array([0.6, 0.0])
    assert world.simulation.succeeded()
    assert world.simulation.hidden_state()["locked"] is False


def test_a_name_is_the_longest_that_fits() -> None:
    joints = [SimpleNamespace(name=f"scene-0_box_{name}") for name in ("knob", "left_knob")]
    assert named_joints(SimpleNamespace(active_joints=joints), ("knob", "left_knob")) == {
        "knob": joints[0],
        "left_knob": joints[1],
    }


# Pushes -------------------------------------------------------------------------------------------------------------


class Scene:
    """A finger at a part whose joint stands at 0 and may go from ``lower`` to 1."""

    timestep = STEP

    def __init__(
        self, kind: str = "prismatic", place: tuple[float, float, float] = (0.0, 0.0, 0.0), lower: float = 0.0
    ) -> None:
        self.finger, self.part, self.place = Link("panda_leftfinger"), Link("part", Joint("part", kind)), place
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
