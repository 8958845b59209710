"""`mesoshell tradeoff`: what accuracy costs in time in the user's scene."""

import time

from mesoshell.cli.described_scene import compiled_by, is_mitsubas, prepare_with_bar
from mesoshell.cli.options.tradeoff import Options
from mesoshell.cli.progress import bar, say_notes, stderr
from mesoshell.scene.prepare import FIXED_BY_XML
from mesoshell.tradeoff.run import begin, explore


def run(options: Options) -> None:
    """All of `mesoshell tradeoff`."""
    begin(options.out, options.minutes)
    console = stderr()
    compiled_by(options.engine)
    ends = time.strftime("%H:%M", time.localtime(time.time() + 60 * options.minutes))
    console.print(
        f"takes {options.minutes:g} minutes (--minutes), until {ends}; Ctrl-C ends it sooner, with what is measured by then",
        soft_wrap=True,
    )
    with bar(console, "preparing") as show:
        made = explore(
            lambda quality: prepare_with_bar(options, quality, None, lambda share: None, shrink=True),
            FIXED_BY_XML if is_mitsubas(options.mesh) else (),
            options.out,
            options.minutes,
            lambda share, what: show(share, what=what),
        )
    say_notes(console, made.notes)
    noise = f"the reference's noise is FLIP {made.reference.noise:.4f}"
    print(f"{len(made.points)} settings, {len(made.front)} pictures on the front; {noise}")
    for entry in made.front:
        print(f"{entry.seconds:8.2f} s  FLIP {entry.flip:.4f}  {entry.described}")
    print(options.out / "report.html")
