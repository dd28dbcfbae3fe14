# SPDX-License-Identifier: Apache-2.0
"""Tasks whose results come in the order of the items, run by this process."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


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


class Workers:
    """Runs tasks in this process; `WorkerProcesses` runs them in others.

    Attributes:
        processes: the most other processes that run tasks at the same time.
    """

    def __init__(self) -> None:
        self.processes = 0
        self._shared = Shared()

    def share(self, name: str, value: object) -> None:
        """Make a value available to all tasks as ``shared[name]``; its arrays are copied once, for all workers.

        Raises:
            ValueError: the name is taken; `forget` frees it.
        """
        self._shared.add(name, value)

    def forget(self, names: Collection[str] | None = None) -> None:
        """Drop shared values, all if no names are given."""
        self._shared.drop(names)

    def map(self, function: Callable[[Shared, _Item], _Result], items: Sequence[_Item]) -> Iterator[_Result]:
        """Yield ``function(shared, item)`` for each item in order, each as soon as it and those before are there.

        The tasks start with the first ``next``; worker processes go on while the caller uses a result. For them, items
        and results are copies with read-only arrays. The results do not depend on the number of workers if a task
        depends on its item and the shared values alone.

        Args:
            function: a function of a module other than the main module.

        Raises:
            WorkerDiedError: a worker was killed or crashed.
            Exception: whatever a task raises, after the results of the items before it.
        """
        for item in items:
            yield function(self._shared, item)

    def map_and_share(
        self, function: Callable[[Shared, _Item], _Result], items: Mapping[str, _Item]
    ) -> Iterator[tuple[str, _Result]]:
        """Yield the name and the result of each item as `map` does, and share the result under that name.

        Raises:
            ValueError: a name is taken.
        """
        for name, item in items.items():
            self._shared.add(name, result := function(self._shared, item))
            yield name, result
