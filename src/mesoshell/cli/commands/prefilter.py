"""`mesoshell prefilter`: correct a material's averaged features. Imports JAX."""

from mesoshell.cli.checks import ends_in
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.options.prefilter import Options
from mesoshell.cli.progress import stderr
from mesoshell.io.atomic import probe_outputs
from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.material import find
from mesoshell.train.prefilter import Gap, fit_correction


def run(options: Options) -> None:
    """All of `mesoshell prefilter`."""
    ends_in(options.out, ".npz")
    probe_outputs((options.out,))
    keep_compiled()
    console = stderr()

    def show(gap: Gap) -> None:
        (light, corrected), (apart, after) = gap.light, gap.rms
        console.print(
            f"level {gap.level}: {light:.2f} of the light, now {corrected:.2f}; views differ by {apart:.0%}, now {after:.0%}"
        )

    bundle = read_bundle(find(options.material))
    with console.status("learning from unfiltered rays"):
        made = fit_correction(bundle, options.material, options.steps, options.seed, show)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_bundle(options.out, made)
    print(options.out)
