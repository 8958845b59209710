"""Shards on a Dask cluster whose machines share the dataset's folder (the extra `cluster`).

The scheduler gives the shard of a worker that died to another one, which keeps the images that are there. A shard's
rows come back when it ends. If the run is killed, workers still finish the shards that they have begun.
"""

from collections.abc import Generator, Sequence
from typing import Any

from mesoshell.datasets.blender.shard import Done, Fault, Shard, render_shard
from mesoshell.errors import Argument, InputError

#: How long a scheduler may take to answer.
_PATIENCE = "10s"


def connect(address: str) -> Any:
    """A Dask client. Raises InputError if Dask is missing or nobody answers at the address."""
    try:
        from distributed import Client
    except ModuleNotFoundError:
        raise InputError(Argument("scheduler"), "needs Dask: pip install mesoshell[cluster]") from None
    try:
        return Client(address, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise InputError(Argument("scheduler"), f"{address} does not answer: {str(error).splitlines()[0]}") from None


def run_on_cluster(shards: Sequence[Shard], client: Any) -> Generator[Done | Fault, None, None]:
    """Results of samples, shard by shard as they finish."""
    from distributed import as_completed

    futures = {client.submit(_whole, shard, pure=False): shard for shard in shards}
    for future in as_completed(futures):
        if future.status == "finished":
            yield from future.result()
        else:
            lines = str(future.exception()).splitlines() or [type(future.exception()).__name__]
            reason = f"its worker failed: {lines[0]}"
            yield from (Fault(index, reason) for index in futures[future].indices)


def _whole(shard: Shard) -> list[Done | Fault]:
    return list(render_shard(shard))
