"""Who makes the frames of a film: this process, others on this machine, or the workers of a Dask cluster."""

from collections.abc import Generator, Iterator

from mesoshell.errors import Argument, InputError
from mesoshell.film.cluster import on_cluster
from mesoshell.film.frame import Crew, Made, Shot, Task, make_frame
from mesoshell.film.processes import in_processes
from mesoshell.scene.picture import Progress


def alone(shot: Shot, tasks: Iterator[Task], count: int, show: Progress) -> Generator[Made, None, None]:
    """Frames that this process makes, in order."""
    for task in tasks:
        yield make_frame(shot, task, show)


def crew_of(workers: int | None, scheduler: str | None) -> Crew:
    """So many processes, or those of the Dask cluster at an address; this process if neither is given. Raises InputError for
    fewer than one, for both, or if no scheduler answers."""
    if workers is not None and workers < 1:
        raise InputError(Argument("workers"), f"must be at least 1, not {workers}")
    if workers is not None and scheduler is not None:
        raise InputError(Argument("workers"), "cannot be combined with `scheduler`, whose workers they are")
    if scheduler is not None:
        return on_cluster(scheduler)
    return alone if workers is None else in_processes(workers)
