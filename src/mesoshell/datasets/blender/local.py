"""Shards on this machine, a few at a time.

A thread a worker: it does little but wait for its Blender process. Results come back through one queue, so only the caller
that iterates over them writes the dataset's lists.
"""

import queue
import threading
from collections.abc import Generator, Iterator, Sequence

from mesoshell.datasets.blender.shard import Done, Fault, Shard, render_shard
from mesoshell.interrupt import arrived


def run_here(shards: Sequence[Shard], workers: int) -> Generator[Done | Fault, None, None]:
    """Results of samples, as they come. When the iteration ends early, every worker finishes its current image."""
    waiting: queue.SimpleQueue[Shard] = queue.SimpleQueue()
    events: queue.SimpleQueue[Done | Fault | BaseException | None] = queue.SimpleQueue()
    stop = threading.Event()
    for shard in shards:
        waiting.put(shard)

    def work() -> None:
        try:
            while not stop.is_set():
                _each(render_shard(waiting.get_nowait()), events, stop)
        except queue.Empty:
            events.put(None)
        except BaseException as error:  # the caller that iterates must see every error
            events.put(error)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(workers)]
    for thread in threads:
        thread.start()
    try:
        running = workers
        while running:
            event = events.get()
            if isinstance(event, BaseException):
                raise event
            if event is None:
                running -= 1
            else:
                yield event
    except BaseException:
        arrived()
        raise
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def _each(results: Iterator[Done | Fault], events: queue.SimpleQueue, stop: threading.Event) -> None:
    for result in results:
        events.put(result)
        if stop.is_set():
            return
