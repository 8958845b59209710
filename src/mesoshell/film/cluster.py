"""Frames by the workers of a Dask cluster, which see the film's folder under the same path (the extra `cluster`)."""

from collections import deque
from collections.abc import Generator, Iterator
from itertools import islice
from typing import Any

from mesoshell.datasets.blender.cluster import connect
from mesoshell.errors import Argument, InputError
from mesoshell.film.frame import Crew, Made, Shot, Task, make_frame
from mesoshell.scene.picture import Progress

#: Frames that a cluster's thread has in hand: one, and the next.
AHEAD = 2


def on_cluster(address: str) -> Crew:
    """Frames by the workers of a Dask scheduler. Raises InputError if it does not answer now, or for what goes wrong there."""
    connect(address).close()

    def crew(shot: Shot, tasks: Iterator[Task], count: int, show: Progress) -> Generator[Made, None, None]:
        with connect(address) as client:
            try:
                yield from _frames(client, shot, tasks)
            except InputError:
                raise
            except Exception as fault:  # of a worker, of the network, of the cluster: whatever Dask hands on
                reason = (str(fault).splitlines() or [type(fault).__name__])[0]
                raise InputError(Argument("scheduler"), f"a frame failed: {reason}") from fault

    return crew


def _frames(client: Any, shot: Shot, tasks: Iterator[Task]) -> Generator[Made, None, None]:
    from distributed import as_completed

    # by a name of its own: one by its content may be on its way out, of the film before
    given = client.scatter(shot, broadcast=True, hash=False)

    def begin(task: Task) -> Any:
        return client.submit(make_frame, given, task._replace(path=task.path.resolve()), pure=False)

    waiting = deque(map(begin, islice(tasks, AHEAD * max(1, sum(client.nthreads().values())))))
    running = as_completed(waiting)
    try:
        for future in running:
            waiting.remove(future)
            made = future.result()
            for task in islice(tasks, 1):
                waiting.append(begin(task))
                running.add(waiting[-1])
            yield made
    finally:
        client.cancel(list(waiting))
