# SPDX-License-Identifier: Apache-2.0
"""Values that tasks share."""

from collections.abc import Collection, Iterable
from typing import Any


class Shared:
    """Values that all tasks of a pool can use; in a worker process, arrays are read-only."""

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
        self.require_free([name])
        self._values[name] = value

    def require_free(self, names: Iterable[str]) -> None:
        """Check that no value has one of these names.

        Raises:
            ValueError: a name is taken.
        """
        for name in names:
            if name in self._values:
                raise ValueError(f"'{name}' is shared already")

    def drop(self, names: Collection[str] | None) -> None:
        """Forget the values of those names, or all."""
        for name in tuple(self._values) if names is None else names:
            del self._values[name]
