"""One host of several, in a process of its own: takes the runs of a plan in turn, and meets what the plan has happen.

Arguments: a JSON file, and this host's number. The plan: port, hosts, method, data, folder, compiled (folder of programs),
quick and join (seconds to be lost after, and to come within, if given) and `runs`, each with the `name` of its folder, `how`,
`saves` (a checkpoint a step) and, if anything happens: what, to which `host`, at which `step`. The state after run i is left
as i.HOST.npz, by its leaves.
What may happen: a signal by its name; parent (SIGKILL of the process that watches); slow (its checkpoints take long);
full (its disk).
"""

import errno
import json
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from mesoshell.cli.host_process import LOST, run_in_child


def main() -> None:
    plan, me = json.loads(Path(sys.argv[1]).read_text()), int(sys.argv[2])
    run_in_child(lambda: work(plan, me), Path(plan["folder"]))


def work(plan: dict[str, Any], me: int) -> None:
    import jax

    from mesoshell.train import hosts, run
    from tests.helpers import methods

    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", plan["compiled"])
    hosts.LOST_AFTER = plan.get("quick", hosts.LOST_AFTER)
    hosts.JOIN_WITHIN = plan.get("join", hosts.JOIN_WITHIN)
    if plan["hosts"] > 1:
        hosts.join(f"localhost:{plan['port']}", (plan["hosts"], me))
    run.spread_step = once(run.spread_step)
    config, data = methods.subject(plan["method"], Path(plan["data"]))
    for number, part in enumerate(plan["runs"]):
        arrange(run, part, me)
        try:
            state = run.train(config, data, Path(plan["folder"]) / part["name"], part.get("how", "jit"))
        except hosts.HostLost as lost:
            print(f"lost: {lost}", file=sys.stderr)
            sys.exit(LOST)
        methods.keep(state, Path(plan["folder"]) / f"{number}.{me}.npz")


def once(make: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a step once for all runs of a plan."""
    made: dict[str, Any] = {}

    def kept(step: Any, batch: int, how: str, together: int) -> Any:
        return made[how] if how in made else made.setdefault(how, make(step, batch, how, together))

    return kept


def arrange(run: Any, part: dict[str, Any], me: int) -> None:
    """Have happen what is to, in the run to come."""
    from mesoshell.errors import InputError
    from mesoshell.train.checkpoint import Checkpoints
    from mesoshell.train.method import method_of
    from tests.helpers import methods

    what = part.get("what") if part.get("host") == me else None
    run.SAVE_EVERY = 0.0 if part.get("saves") else 120.0

    def fed(of: Any, *arguments: Any) -> Any:
        at = of(*arguments)

        def batch(i: int) -> Any:
            if i == part.get("step") and what:
                if what in signal.Signals.__members__:
                    os.kill(os.getpid(), signal.Signals[what])
                if what == "parent":
                    os.kill(os.getppid(), signal.SIGKILL)
                    time.sleep(60)
            return at(i)

        return batch

    save = methods.plain_save()

    def saved(self: Checkpoints, step: int, tree: Any) -> None:
        if what == "slow":
            time.sleep(0.5)
        if what == "full" and step >= part["step"]:
            raise InputError(self.folder, f"cannot be written: {os.strerror(errno.ENOSPC)}")
        save(self, step, tree)

    Checkpoints.save = saved  # type: ignore[method-assign]

    def lit(config: Any) -> Any:
        method = methods.light(method_of(config))
        return method._replace(feed=partial(fed, method.feed))

    run.method_of = lit


if __name__ == "__main__":
    main()
