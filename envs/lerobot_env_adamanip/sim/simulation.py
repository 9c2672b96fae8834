"""One episode's simulation: the arm, the object with its hidden mechanism, their contacts, and the control tick."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lerobot_adamanip.contract.rotations import rotation_vector_from_matrix
from lerobot_adamanip.contract.schema import JOINT_NAMES
from lerobot_adamanip.episode.tries import Push, TryTracker
from lerobot_adamanip.mechanisms import Limits, Mechanism
from lerobot_adamanip.objects import ArticulatedObject
from lerobot_env_adamanip.sim.kinematics import NUM_ARM_JOINTS, ArmKinematics

if TYPE_CHECKING:  # so that it can be imported and tested without a simulator
    import sapien

Array = NDArray[np.float64]

CONTACT_OFFSET = 0.002
"""Half of the distance at which PhysX creates contacts between two bodies [m]. The fastest hand moves 2.3 mm per
physics step. ManiSkill's 20 mm creates contacts with everything near the hand, at up to three times the cost."""
FREE_ITERATIONS = 4
"""Solver iterations of an arm without contacts. More iterations only harden contacts, and cost time."""
GRIP_TICKS = 8
"""Control ticks in which fingers settle around a part."""
STAYING = 1e-3
"""Maximum motion of joint targets in a control tick at which the arm stays [rad]."""
VELOCITY_LAG = 0.1
"""Time in which a drive of velocities would catch up with its lag [s]."""
TOUCH_FORCE = 1.0
"""Minimum force of a push along the joint's motion, or of a grip [N]; a weaker one is a graze."""
PUSH_LAG, PUSH_TURN_LAG = 0.002, 0.01
"""Minimum lag of a pushing hand [m, rad]: about 9 N, a third of the lag that ends a motion as a stall."""
PUSH_WAY, PUSH_TURN = PUSH_LAG / 2, PUSH_TURN_LAG / 2
"""Minimum travel of a meant push since the arm was last free of strain [m, rad]. The arm is free of strain below half
of the lag, so the target of a hand that is held back travels this far; that of a deflected hand does not."""
PUSH_TICKS = 20
"""Maximum number of control ticks of that travel. A hand that holds a lever against its spring is never free."""
PUSH_SHARE = 0.7
"""Minimum share of a meant push along the part's motion; a hand that moves elsewhere only passes by."""
NEAR_AXIS = 0.05
"""Distance from a revolute joint's axis below which a hand turns the part by its own rotation [m]."""
METRES_PER_RADIAN = 0.3
"""Motion of a hand that counts as much as its rotation by one radian [m/rad]."""
NO_ROOM = 1e-3
"""Distance to its nominal limit below which a joint cannot move farther in that direction [rad or m]."""


@dataclass
class ArmState:
    """State of the arm's joints. Arrays are (7,), except ``fingers`` (2,): [rad], [rad/s], [m]."""

    qpos: Array
    qvel: Array
    fingers: Array


class Simulation:
    """Arm, object and mechanism of one episode. Nothing calls back: drivers, environments and the twin call `tick`.

    The object's joints stay within the mechanism's limits. A *held* joint has its limits closed around its position.
    This models the latch, detent or friction of a real joint, and makes the simulator bit-identical under every hidden
    state. A joint is held while it is at rest and no try moves it, see `TryTracker`: neither the way to a part, nor
    contact, nor a graze shows anything. All joints are held while fingers close: they close unevenly, and would move a
    free joint before its next try.

    Args:
        system: physics engine of the scene.
        arm: arm with nine joints, the fingers last. Its solver iterations are those for contacts.
        target: the object's articulation.
        kinematics: kinematics of the arm.
        obj: the object.
        mechanism, state: its mechanism and this episode's hidden state.
        steps: physics steps per control tick.
        hold: whether joints are held. Tests disable it to show its effect.

    Attributes:
        tries: tries of this episode.
        ticks: number of control ticks of key frames and streams so far.
    """

    def __init__(
        self,
        system: sapien.physx.PhysxCpuSystem,
        arm: sapien.physx.PhysxArticulation,
        target: sapien.physx.PhysxArticulation,
        *,
        kinematics: ArmKinematics,
        obj: ArticulatedObject,
        mechanism: Mechanism[Any],
        state: Any,
        steps: int,
        hold: bool = True,
    ) -> None:
        self.kinematics, self.obj, self.mechanism, self.state, self.ticks = kinematics, obj, mechanism, state, 0
        self._system, self._arm, self._target = system, arm, target
        self._steps, self._hold_joints = steps, hold
        self._drives, self._fingers = arm.active_joints[:NUM_ARM_JOINTS], arm.active_joints[NUM_ARM_JOINTS:]
        self._arm_links = set(arm.links)
        self._touching_iterations = self._iterations = arm.get_solver_position_iterations()
        self._joints = named_joints(target, mechanism.joints)
        self._limits: dict[str, Limits] = {}
        self._held: dict[str, float] = {}
        self._last_finger, self._grip_ticks = np.inf, 0
        self._last_target: Array = np.zeros(NUM_ARM_JOINTS)
        self._contacts = ArmContacts(system, arm, target, obj)
        self._apply_mechanism(mechanism.joints)
        self.restart_tries()

    def tick(self, target: Array, velocity: Array, finger: float) -> None:
        """Advances one control tick with joint targets (7,) [rad], their velocities (7,) [rad/s] and a finger [m]."""
        for joint, position, speed in zip(self._drives, target.tolist(), velocity.tolist(), strict=True):
            joint.set_drive_target(position)
            joint.set_drive_velocity_target(speed)
        for joint in self._fingers:
            joint.set_drive_target(finger)
        touches = False
        for _ in range(self._steps):
            # PhysX reports a contact before it happens, see `CONTACT_OFFSET`: every contact step has all iterations.
            touches = touches or any(
                not self._arm_links.isdisjoint(contact.bodies) for contact in self._system.get_contacts()
            )
            iterations = self._touching_iterations if touches else FREE_ITERATIONS
            if iterations != self._iterations:
                self._arm.set_solver_position_iterations(iterations)
                self._iterations = iterations
            self._system.step()
        self.ticks += 1
        self._follow_tries(target)

    def follow_control_step(self) -> None:
        """Follows tries after one of ManiSkill's own control steps, in any of its control modes.

        A drive of velocities has a target that is `VELOCITY_LAG` ahead of the arm.
        """
        qpos, qvel = self._arm.get_qpos(), self._arm.get_qvel()
        targets = [
            joint.drive_target[0]
            if joint.stiffness
            else qpos[k] + VELOCITY_LAG * (joint.drive_velocity_target[0] - qvel[k])
            for k, joint in enumerate(self._drives)
        ]
        self._follow_tries(np.array(targets, np.float64))

    def _follow_tries(self, target: Array) -> None:
        """Follows tries for one control tick with joint targets (7,) [rad], and holds and releases joints by them.

        Fingers close around a part if their target falls, or fell `GRIP_TICKS` ago, and the arm stays.
        """
        pushes = self._contacts.pushes(*map(self.kinematics.tcp_in_base, (target, self.arm_state().qpos)))
        finger = float(self._fingers[0].drive_target[0])
        self._grip_ticks = GRIP_TICKS if finger < self._last_finger < np.inf else max(0, self._grip_ticks - 1)
        is_closing = self._grip_ticks > 0 and float(np.abs(target - self._last_target).max()) < STAYING
        self._last_finger, self._last_target = finger, target
        self.tries.update({} if is_closing else pushes, self.joint_positions())
        self._apply_mechanism(self.mechanism.joints if is_closing else self.tries.at_rest())

    def _apply_mechanism(self, held: Collection[str]) -> None:
        """Steps the mechanism and writes its limits, except for ``held`` joints, which stay where they are."""
        if not self._hold_joints:
            held = ()
        if self._held.keys() == self._joints.keys() == set(held):
            return  # nothing has moved since, and nothing can
        positions = self.joint_positions()
        self._held = {name: self._held.get(name, positions[name]) for name in held}
        self.state, command = self.mechanism.step(self.state, positions)
        for name, joint in self._joints.items():
            limits = (self._held[name], self._held[name]) if name in self._held else command[name]
            if self._limits.get(name) != limits:
                joint.set_limits([list(limits)])
                self._limits[name] = limits

    @property
    def held(self) -> frozenset[str]:
        """Joints that are held now."""
        return frozenset(self._held)

    def arm_state(self) -> ArmState:
        """Returns the present state of the arm's joints."""
        qpos = np.asarray(self._arm.get_qpos(), np.float64)
        qvel = np.asarray(self._arm.get_qvel(), np.float64)
        return ArmState(qpos[:NUM_ARM_JOINTS], qvel[:NUM_ARM_JOINTS], qpos[NUM_ARM_JOINTS:])

    def joint_positions(self) -> dict[str, float]:
        """Returns the object's joint positions [rad or m]; privileged, for mechanism, success and records."""
        return dict(zip(self._joints, self._target.get_qpos().tolist(), strict=True))

    def joints(self) -> NDArray[np.float32]:
        """Returns the positions of all joints, (13,), see `lerobot_adamanip.contract.schema.JOINT_NAMES`."""
        positions = np.concatenate([self._arm.get_qpos(), self._target.get_qpos()])
        return np.pad(positions, (0, len(JOINT_NAMES) - len(positions))).astype(np.float32)

    def set_joints(self, joints: NDArray[np.float32]) -> None:
        """Sets all joints to ``joints`` (13,), at rest, without a physics step."""
        ends = np.cumsum([self._arm.dof, self._target.dof])
        for articulation, positions in zip((self._arm, self._target), np.split(joints, ends), strict=False):
            articulation.set_qpos(positions)
            articulation.set_qvel(np.zeros_like(positions))

    def hidden_state(self) -> dict[str, Any]:
        """Returns the hidden state, JSON-serialisable; privileged, never part of an observation."""
        return self.mechanism.hidden(self.state)

    def succeeded(self) -> bool:
        """Returns whether a joint is beyond its goal, see `Mechanism.goals`."""
        return self.mechanism.succeeded(self.joint_positions())

    def restart_tries(self) -> None:
        """Drops all tries so far."""
        kinds = {name: self.obj.joint(name).kind for name in self.mechanism.joints}
        self.tries = TryTracker(kinds, self.joint_positions())


class ArmContacts:
    """Measures the push of an arm on each joint of a target that any of its links touches.

    The nominal limits of the object's joints are public and equal under every hidden state.
    """

    def __init__(
        self,
        system: sapien.physx.PhysxCpuSystem,
        arm: sapien.physx.PhysxArticulation,
        target: sapien.physx.PhysxArticulation,
        obj: ArticulatedObject,
    ) -> None:
        self._system, self._target = system, target
        self._ranges = {link.joint.name: link.joint.limits for link in obj.links if link.joint is not None}
        self._arm = {link.entity for link in arm.links}
        self._joints = named_joints(target, self._ranges)
        self._carrying = {link.entity: self._joints_above(link) for link in target.links}
        self._before: list[Array] = []
        """Tool poses of the joint targets since the arm was free of strain, the latest last."""

    def _joints_above(self, link: Any) -> tuple[str, ...]:
        names = {joint.name: name for name, joint in self._joints.items()}
        above: list[str] = []
        while link is not None:
            if link.joint.dof:
                above.append(names[link.joint.name])
            link = link.parent
        return tuple(above)

    def pushes(self, wanted: Array, actual: Array) -> dict[str, Push]:
        """Returns the push on each joint that carries a touched link. Call this after every tick.

        A joint holds the arm back if the hand lags behind its target along the joint's motion by more than half
        of `PUSH_LAG`, while it grips the part, or presses on it in that direction, with more than
        `TOUCH_FORCE`. PhysX reports no friction, so what a grip transmits is measured by the lag alone. The
        push is meant if the hand lags by all of `PUSH_LAG`, and its target, which does not move back, has moved
        by more than `PUSH_WAY` since the arm was free of strain, mostly along this motion. A hand that grazes a
        part, is deflected by it, or leans on it in another direction, means no push; nor does one that pushes a
        joint past its nominal limit, or gives up its strain.

        Args:
            wanted: tool pose (4, 4) of the joint targets.
            actual: present tool pose (4, 4).
        """
        lag = wanted @ np.linalg.inv(actual)
        turn = float(np.linalg.norm(rotation_vector_from_matrix(lag[:3, :3]))) / PUSH_TURN_LAG
        strain = float(np.linalg.norm(wanted[:3, 3] - actual[:3, 3])) / PUSH_LAG
        touched = self._touched()
        if not touched or max(strain, turn) < 0.5:
            self._before = self._before[-1:]
        before = self._before or [wanted]
        self._before = [*self._before, wanted][-PUSH_TICKS:]
        return {name: self._push(name, wanted, before, lag, contacts) for name, contacts in touched.items()}

    def _touched(self) -> dict[str, list[tuple[Array, Array]]]:
        """Returns joint -> place [m] and force [N] of each contact of the arm with a link that the joint carries."""
        touched: dict[str, list[tuple[Array, Array]]] = {}
        for contact in self._system.get_contacts():
            first, second = contact.bodies[0].entity, contact.bodies[1].entity
            link, sign = (second, -1.0) if first in self._arm else (first, 1.0) if second in self._arm else (None, 0.0)
            if carrying := self._carrying.get(link, ()):
                for point in contact.points:
                    if np.any(point.impulse):
                        force = sign / self._system.timestep * np.asarray(point.impulse, np.float64)
                        for name in carrying:
                            touched.setdefault(name, []).append((np.asarray(point.position, np.float64), force))
        return touched

    def _push(
        self, name: str, wanted: Array, before: list[Array], lag: Array, contacts: list[tuple[Array, Array]]
    ) -> Push:
        """Returns the push on one joint from its contacts.

        Args:
            name: joint.
            wanted: tool pose (4, 4) of the joint targets, robot base frame.
            before: the same at some ticks before, the latest last.
            lag: motion (4, 4) from the present tool pose to ``wanted``.
            contacts: place [m] and force on the part [N] of each contact.
        """
        places, forces = map(np.array, zip(*contacts, strict=True))
        joint, sizes = self._joints[name], np.linalg.norm(forces, axis=1)
        axis, along, radius = _motion(joint, place := np.average(places, axis=0, weights=sizes))
        is_near_axis = joint.type != "prismatic" and radius < NEAR_AXIS
        strain = float(_shift(lag, place) @ along) / PUSH_LAG
        turn = float(rotation_vector_from_matrix(lag[:3, :3]) @ axis) / PUSH_TURN_LAG
        latest = wanted @ np.linalg.inv(before[-1])
        if is_near_axis:
            sent = float(rotation_vector_from_matrix(latest[:3, :3]) @ axis)
        else:
            sent = float(_shift(latest, place) @ along) / (1.0 if joint.type == "prismatic" else radius)
        turns = is_near_axis and abs(turn) > abs(strain)
        strain = turn if turns else strain
        direction = 1 if strain > 0 else -1
        grip = float(sizes.sum() - np.linalg.norm(forces.sum(0)))
        transmits = max(grip, direction * float(forces.sum(0) @ along)) > TOUCH_FORCE
        if not transmits or abs(strain) < 0.5 or self._room(name, direction) < NO_ROOM:
            return Push(sent)
        way = direction * (axis if turns else along)
        is_meant = (
            abs(strain) > 1
            and direction * sent >= 0
            and any(_is_along(wanted @ np.linalg.inv(pose), place, way, turns) for pose in reversed(before))
        )
        return Push(sent, direction, is_meant)

    def _room(self, name: str, direction: int) -> float:
        """Returns how far a joint's nominal range lets it move in a direction [rad or m]."""
        lower, upper = self._ranges[name]
        position = float(self._target.get_qpos()[list(self._joints).index(name)])
        return upper - position if direction > 0 else position - lower


def _motion(joint: Any, place: Array) -> tuple[Array, Array, float]:
    """Returns a joint's axis (3,), the unit vector (3,) of the motion of ``place`` (3,) with it, and a radius.

    The radius [m] is the distance from the axis of a revolute joint; on it the unit vector is zero.
    """
    pose = joint.global_pose.to_transformation_matrix().astype(np.float64)
    axis = pose[:3, 0]
    if joint.type == "prismatic":
        return axis, axis, 0.0
    across = np.cross(axis, place - pose[:3, 3])
    radius = float(np.linalg.norm(across))
    return axis, across / max(radius, 1e-9), radius


def _shift(motion: Array, place: Array) -> Array:
    """Returns how far a motion (4, 4) moves ``place`` (3,) [m]."""
    moved: Array = motion[:3, :3] @ place + motion[:3, 3] - place
    return moved


def _is_along(motion: Array, place: Array, way: Array, turns: bool) -> bool:
    """Returns whether a motion (4, 4) moves ``place`` (3,) mostly along ``way`` (3,), or turns mostly about it."""
    shift, turn = _shift(motion, place), rotation_vector_from_matrix(motion[:3, :3])
    if not turns:
        return bool(shift @ way > max(PUSH_WAY, PUSH_SHARE * float(np.linalg.norm(shift))))
    whole = float(np.linalg.norm(shift)) / METRES_PER_RADIAN + float(np.linalg.norm(turn))
    return bool(turn @ way > max(PUSH_TURN, PUSH_SHARE * whole))


def named_joints(articulation: Any, names: Collection[str]) -> dict[str, Any]:
    """Returns name -> active joint of an articulation, in its order; ManiSkill prefixes names with scene and object."""
    return {
        max((name for name in names if f"_{joint.name}".endswith(f"_{name}")), key=len): joint
        for joint in articulation.active_joints
    }
