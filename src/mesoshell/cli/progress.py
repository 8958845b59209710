"""What a command prints on standard error while it works: bars and notes. A bar is drawn on a terminal only."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class MoveBar(Protocol):
    """Move a bar on. done: of how much, and of what (both as before if not given)."""

    def __call__(self, done: float, of: float | None = None, what: str | None = None) -> None: ...


def stderr() -> Console:
    """The console that bars and notes go to."""
    return Console(stderr=True, highlight=False)


@contextmanager
def bar(console: Console, what: str, total: int | float | None = 1.0, count: bool = False) -> Iterator[MoveBar]:
    """A bar that is removed at the end. count: also show numbers, done of total; leave it off where `done` is a share."""
    columns = [TextColumn("{task.description}", markup=False), BarColumn(), TimeElapsedColumn()]
    columns += [TextColumn("left"), TimeRemainingColumn()]
    columns[2:2] = [MofNCompleteColumn()] * count
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=total)
        yield lambda done, of=None, what=None: progress.update(task, completed=done, total=of, description=what)


def say_notes(console: Console, notes: Sequence[object]) -> None:
    """Print what the user should know, a line each."""
    for note in notes:
        console.print(f"[dim]note:[/] {escape(str(note))}", soft_wrap=True)
