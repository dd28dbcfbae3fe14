# SPDX-License-Identifier: Apache-2.0
"""Values that tasks share."""

from typing import Any

__all__ = ["Shared"]


class Shared:
    """What all tasks of a pool can use; in a worker process, arrays are read-only."""

    def __init__(self) -> None:
        self._values: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:  # noqa: ANN401 - the task knows what was shared
        """Return the value that was shared under that name."""
        return self._values[name]

    def add(self, name: str, value: object) -> None:
        """Make a value available under a name.

        Raises:
            ValueError: the name is taken.
        """
        if name in self._values:
            raise ValueError(f"'{name}' is shared already")
        self._values[name] = value

    def clear(self) -> None:
        """Forget all values."""
        self._values.clear()
