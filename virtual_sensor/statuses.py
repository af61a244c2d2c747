"""Statuses: why there is a result, or none. Each member says it in a sentence."""

from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray


class StatusEnum(IntEnum):
    """Base of all statuses: numbers in arrays, whose members carry a message.

    ``Status(line.status[5]).message`` is that of one number, `of` gives the members of a whole
    array, `counts` how many there are of each.

    Attributes
    ----------
    message : str
        What happened, and what to do about it, in one sentence.
    """

    message: str

    def __new__(cls, number: int, message: str = "") -> Self:
        """A member; its message is given where the members are listed."""
        member = int.__new__(cls, number)
        member._value_ = number
        member.message = message
        return member

    def __repr__(self) -> str:
        return f"{type(self).__name__}.{self.name}"

    @classmethod
    def of(cls, status: ArrayLike) -> NDArray[np.object_]:
        """The members of status numbers, in an array of the same shape."""
        numbers = np.asarray(status)
        members = [cls(number) for number in numbers.ravel().tolist()]
        return np.array(members, object).reshape(numbers.shape)

    @classmethod
    def counts(cls, status: ArrayLike) -> dict[Self, int]:
        """How many numbers are of each member that occurs, the most frequent first.

        ``for status, count in Status.counts(line.status).items(): print(count, status.message)``
        """
        numbers, counts = np.unique(np.asarray(status), return_counts=True)
        order = np.argsort(-counts, kind="stable")
        return {cls(n): int(c) for n, c in zip(numbers[order], counts[order], strict=True)}
