"""The mailbox: whole values or none, whoever dies when."""

from __future__ import annotations

import threading

import pytest

from lerobot_adamanip.hardware.arm_process.mailbox import Mailbox, SharedMailboxes
from lerobot_adamanip.util.errors import RobotError


@pytest.fixture
def memory() -> bytearray:
    return bytearray(Mailbox.size(1000))


def test_the_newest_value_is_read_and_numbers_count_up(memory: bytearray) -> None:
    writer, reader = Mailbox(memoryview(memory), 1000), Mailbox(memoryview(memory), 1000)
    assert reader.read() is None
    for number in range(1, 6):
        assert writer.write(bytes([number]) * (number * 100)) == number
        assert reader.read() == (number, bytes([number]) * (number * 100))
    with pytest.raises(ValueError, match="1001 bytes, more than 1000"):
        writer.write(bytes(1001))
    assert reader.number == 5


@pytest.mark.parametrize("written", [0, 1, 17])
def test_a_writer_that_dies_in_the_middle_spoils_nothing(memory: bytearray, written: int) -> None:
    Mailbox(memoryview(memory), 1000).write(b"whole" * 10)
    stride = (len(memory) - 8) // 2
    half_written = 8 + 0 * stride  # value 2 goes into slot 0
    memory[half_written : half_written + written] = bytes([255]) * written
    assert Mailbox(memoryview(memory), 1000).read() == (1, b"whole" * 10)


def test_a_value_that_does_not_match_its_checksum_is_an_error(memory: bytearray) -> None:
    Mailbox(memoryview(memory), 1000).write(b"whole" * 10)
    memory[8 + (len(memory) - 8) // 2 + 24] ^= 1
    with pytest.raises(RobotError, match="never whole"):
        Mailbox(memoryview(memory), 1000).read()


def test_a_reader_beside_a_busy_writer_sees_whole_values_in_order(memory: bytearray) -> None:
    writer, reader, done = Mailbox(memoryview(memory), 1000), Mailbox(memoryview(memory), 1000), threading.Event()

    def write() -> None:
        for number in range(1, 20_001):
            writer.write(bytes([number % 251]) * (number % 1000))
        done.set()

    thread = threading.Thread(target=write)
    thread.start()
    last = 0
    while not done.is_set():
        if (found := reader.read()) is not None:
            number, value = found
            assert number >= last
            assert value == bytes([number % 251]) * (number % 1000)
            last = number
    thread.join()


def test_names_share_one_memory_through_its_descriptor() -> None:
    capacities = {"command": 64, "status": 100, "front": 5000}
    ours = SharedMailboxes(capacities)
    theirs = SharedMailboxes(capacities, ours.descriptor)
    for name, capacity in capacities.items():
        ours[name].write(name.encode() * (capacity // len(name)))
    for name, capacity in capacities.items():
        assert theirs[name].read() == (1, name.encode() * (capacity // len(name)))
    ours.close()
    ours.close()
    assert theirs["front"].read() is not None
