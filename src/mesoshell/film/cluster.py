"""Frames by the workers of a Dask cluster, which see the film's folder under the same path (the extra `cluster`)."""

from collections import deque
from collections.abc import Callable, Generator, Iterator
from itertools import islice
from typing import Any

from mesoshell.film.frame import Crew, Made, Shot, Task, make_frame

#: Frames that a cluster's thread has in hand: one, and the next.
AHEAD = 2


def on_cluster(client: Any) -> Crew:
    """Frames by the workers of a Dask client."""

    def crew(shot: Shot, tasks: Iterator[Task], show: Callable[[int, float], None]) -> Generator[Made, None, None]:
        from distributed import as_completed

        given = client.scatter(shot, broadcast=True, hash=False)  # what is alike may be on its way out

        def begin(task: Task) -> Any:
            return client.submit(make_frame, given, task._replace(path=task.path.resolve()), pure=False)

        threads = sum(client.nthreads().values()) or 1
        waiting = deque(map(begin, islice(tasks, AHEAD * threads)))
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

    return crew
