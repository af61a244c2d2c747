"""Which of several are worth choosing: no other is better in both parts of its cost."""

from collections.abc import Callable, Iterable
from typing import TypeVar

Item = TypeVar("Item")


def not_beaten(items: Iterable[Item], cost: Callable[[Item], tuple[float, float]]) -> list[Item]:
    """Those that no other beats in both parts of their cost, by the first; equals stay together."""
    front: list[Item] = []
    for item in sorted(items, key=cost):
        if not front or cost(item)[1] < cost(front[-1])[1] or cost(item) == cost(front[-1]):
            front.append(item)
    return front
