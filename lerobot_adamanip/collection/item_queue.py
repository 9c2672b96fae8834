"""A queue from which workers take items of the category they are at."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable


class ItemQueue[Item]:
    """Items by category, each category's in their order.

    Args:
        items: to be taken.
        category: of an item. Changing it costs a worker seconds.
    """

    def __init__(self, items: Iterable[Item], category: Callable[[Item], str]) -> None:
        self._category = category
        self._items: dict[str, deque[Item]] = {}
        for item in items:
            self._items.setdefault(category(item), deque()).append(item)

    def __len__(self) -> int:
        return sum(map(len, self._items.values()))

    def take(self, present: str | None) -> tuple[Item, str]:
        """Returns the next item of category ``present``, or of the one with most items left; and its category."""
        name = present if present is not None and self._items.get(present) else max(self._items, key=self._left)
        return self._items[name].popleft(), name

    def put_back(self, item: Item) -> None:
        """Makes an item the next one of its category."""
        self._items.setdefault(self._category(item), deque()).appendleft(item)

    def _left(self, name: str) -> int:
        return len(self._items[name])
