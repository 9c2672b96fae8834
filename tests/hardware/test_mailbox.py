"""Messages of the arm process and their mailboxes: whole values with their types and bits, or an error."""

from __future__ import annotations

import dataclasses
import enum
import json
import os
import threading
import types
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from lerobot_adamanip.contract.keyframes import Outcome
from lerobot_adamanip.contract.rotations import transform
from lerobot_adamanip.episode.options import EnvironmentOptions
from lerobot_adamanip.hardware.arm import (
    ArmMode,
    ArmReading,
    ArmStatus,
    ArmTarget,
    Execution,
    Reply,
    Request,
    ServerOptions,
    Start,
)
from lerobot_adamanip.hardware.arm_process.mailbox import (
    HEADER_BYTES,
    Mailbox,
    _registered,
    create_memory,
    decode,
    encode,
    map_mailboxes,
)
from lerobot_adamanip.hardware.backends.franky_options import FrankyOptions
from lerobot_adamanip.hardware.camera_frames import Frame
from lerobot_adamanip.hardware.safety import SafetyLimits
from lerobot_adamanip.objects.base import Motion, PartAnnotation
from lerobot_adamanip.util.errors import RobotError
from lerobot_env_adamanip.twin.process import TwinOptions

CAPACITY = 2000


@pytest.fixture
def memory() -> bytearray:
    return bytearray(Mailbox.size(CAPACITY))


def box(memory: bytearray) -> Mailbox:
    return Mailbox(memoryview(memory), CAPACITY)


def test_the_newest_value_is_read_and_numbers_count_up(memory: bytearray) -> None:
    writer, reader = box(memory), box(memory)
    assert reader.read() is None
    for number in range(1, 6):
        assert writer.write({"value": number * "x"}) == number
        assert reader.read() == (number, {"value": number * "x"})
    with pytest.raises(ValueError, match="more than 2000"):
        writer.write(CAPACITY * "x")
    assert reader.number == 5


@pytest.mark.parametrize("written", [0, 1, 17])
def test_a_writer_that_dies_in_the_middle_spoils_nothing(memory: bytearray, written: int) -> None:
    box(memory).write("whole")
    memory[HEADER_BYTES : HEADER_BYTES + written] = bytes([255]) * written  # value 2 goes into slot 0
    assert box(memory).read() == (1, "whole")


def test_a_value_that_does_not_match_its_checksum_is_an_error(memory: bytearray) -> None:
    box(memory).write("whole")
    memory[HEADER_BYTES + CAPACITY + len(encode("whole")) - 3] ^= 1
    with pytest.raises(RobotError, match="never whole"):
        box(memory).read()


def test_a_reader_beside_a_busy_writer_sees_whole_values_in_order(memory: bytearray) -> None:
    writer, reader, done = box(memory), box(memory), threading.Event()

    def write() -> None:
        for number in range(1, 20_001):
            writer.write(number % 1000 * chr(97 + number % 26))
        done.set()

    thread = threading.Thread(target=write)
    thread.start()
    last = 0
    while not done.is_set():
        if (found := reader.read()) is not None:
            number, value = found
            assert number >= last
            assert value == number % 1000 * chr(97 + number % 26)
            last = number
    thread.join()


def test_names_share_one_memory_through_its_descriptor() -> None:
    capacities = {"command": 64, "status": 100, "front": 5000}
    memory = create_memory(capacities)
    ours, theirs = map_mailboxes(memory, capacities), map_mailboxes(memory, capacities)
    os.close(memory)
    for name, each in ours.items():
        each.write(name)
    for name, each in theirs.items():
        assert each.read() == (1, name)


DRAW = np.random.default_rng(0)
POSE = DRAW.normal(size=(4, 4))
READING = ArmReading(
    0.1 + 0.2,
    5e-324,
    POSE.T,
    1 / 3,
    POSE[0],
    POSE[1, :3],
    POSE[:, 2],
    ArmMode.REFLEX,
    ("joint_reflex",),
    Outcome.STALLED,
)
TARGET = ArmTarget(DRAW.normal(size=10).astype(np.float32), Execution.STREAM, 1e9 / 3)
PART = PartAnnotation("knob", transform((0, 0, 1)), (Motion("door", "revolute", POSE[0, :3], POSE[1, :3]),))
SCENES = EnvironmentOptions("microwave", hidden_overrides={"locked": True}, logged_seeds=(3, 9))
COLOR, DEPTH = DRAW.integers(0, 255, (8, 6, 3), np.uint8), DRAW.integers(0, 65535, (8, 6), np.uint16)
MESSAGES = [
    READING,
    TARGET,
    ArmStatus(1e-9, READING, 3, fault='ein "Reflex" \u2192 \0'),
    ArmStatus(0.0, dataclasses.replace(READING, qvel=np.array([np.nan, np.inf, -0.0]), outcome=None)),
    Start(
        FrankyOptions(address="172.16.0.2", model="fr3"),
        ServerOptions(limits=SafetyLimits((0.1, 0, 0), (10 / 3, 2, 2.5))),
        {"command": 9},
    ),
    Start(TwinOptions(SCENES, seed=7), ServerOptions(lockstep_fps=30.0), {}),
    Request(2**31, "inject", {"flags": ["a"], "wait": 0.1, "deep": {"none": None}}),
    Reply(4, None, {"annotations": {"knob": PART}, "rolls": (1, (2.5, ())), "number": np.float32(0.1)}),
    Frame(1.0, 2.0, COLOR, DEPTH, 12),
    Frame(1.0, 2.0, None, DEPTH[::2, ::2], 12),
]


def assert_same(sent: Any, got: Any) -> None:
    if isinstance(sent, np.ndarray):
        assert (sent.dtype, sent.shape, sent.tobytes()) == (got.dtype, got.shape, got.tobytes())
        assert got.flags.writeable
    elif isinstance(sent, np.generic):
        assert sent.item() == got
    elif dataclasses.is_dataclass(sent):
        assert type(sent) is type(got)
        for field in dataclasses.fields(sent):
            assert_same(getattr(sent, field.name), getattr(got, field.name))
    elif isinstance(sent, Mapping):
        assert list(sent) == list(got)
        for key in sent:
            assert_same(sent[key], got[key])
    elif isinstance(sent, list | tuple):
        assert type(sent) is type(got)
        for ours, theirs in zip(sent, got, strict=True):
            assert_same(ours, theirs)
    else:
        assert (type(sent), repr(sent)) == (type(got), repr(got))


@pytest.mark.parametrize("sent", MESSAGES, ids=lambda message: type(message).__name__)
def test_a_message_arrives_with_its_types_and_bits(sent: Any) -> None:
    data = encode(sent)
    assert_same(sent, decode(data, type(sent)))
    for end in {0, 1, len(data) // 2, len(data) - 1}:
        with pytest.raises(RobotError, match="cannot be read"):
            decode(data[:end], type(sent))
    with pytest.raises(RobotError, match="1 bytes left over"):
        decode(data + b"x", type(sent))


def test_every_registered_message_is_tested() -> None:
    tested = "".join(encode(each).partition(b"\0")[0].decode() for each in MESSAGES)
    ours = [name for name, kind in _registered.items() if kind.__module__.startswith("lerobot_")]
    assert [name for name in ours if f'"@":"{name}"' not in tested] == []


@pytest.mark.parametrize(
    "head",
    [
        {"@": "Popen", "args": "ls"},
        {"@": "Request", "number": 1},
        {"@": "Request", "number": 1, "ask": "stop", "more": 1},
        {"@": "Reply", "number": 1},
        {"@": "ArmMode", "value": 99},
        {"@": "array", "dtype": "|O", "shape": [0]},
        {"@": "array", "dtype": "<f8", "shape": [2]},
        ["no message"],
    ],
)
def test_an_unknown_or_malformed_message_is_refused(head: Any) -> None:
    with pytest.raises(RobotError, match=r"(?s)cannot be read.*Request"):
        decode(json.dumps(head).encode() + b"\0", Request)


class Unknown(enum.IntEnum):
    ONE = 1


@pytest.mark.parametrize("value", [Unknown.ONE, object(), {1: 2}, {"@": "Request"}, types.SimpleNamespace(), b"raw"])
def test_what_is_not_registered_is_not_sent(value: Any) -> None:
    with pytest.raises(TypeError):
        encode([value])
