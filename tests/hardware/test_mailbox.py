"""The mailbox: whole values or none, whoever dies when."""

from __future__ import annotations

import os
import threading

import pytest

from lerobot_adamanip.hardware.arm_process.mailbox import HEADER_BYTES, Mailbox, create_memory, encode, map_mailboxes
from lerobot_adamanip.util.errors import RobotError

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
