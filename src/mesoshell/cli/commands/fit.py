"""`mesoshell fit`: a material of patches, from renders of them. Imports JAX."""

from mesoshell.cli.learn import learn
from mesoshell.cli.options.fit import Options
from mesoshell.cli.progress import stderr
from mesoshell.errors import InputError
from mesoshell.io.atomic import probe_outputs
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.dataset import read_dataset
from mesoshell.io.exemplars import write_exemplars
from mesoshell.io.image import write_png
from mesoshell.io.names import distinct_names
from mesoshell.train.fit.holdout import Scores
from mesoshell.train.fit.result import conclude, fit_config, fit_data_for
from mesoshell.train.parallel import rows_of, split_cpu


def run(options: Options) -> None:
    """All of `mesoshell fit`."""
    split_cpu(rows_of(options.rays))  # before JAX starts
    console = stderr()
    config = fit_config(
        options.steps, options.rays, options.texels, options.width, options.held, options.decoder, options.seed
    )
    probe_outputs((options.out,))
    datasets, tests = ([read_dataset(d) for d in folders] for folders in (options.datasets, options.test))
    if not datasets:
        raise InputError("fit", "no dataset given")
    with console.status("reading images"):
        data = fit_data_for(config, datasets, tests)
    count = sum(map(len, data.learned))
    console.print(f"{count:,} rays of {len(data.learned)} patches in {len(data.samples):,} images")
    state = learn(config, data, options.run)
    made, scores, sheets = conclude(config, data, state, datasets, tests)
    for (folder, scored), name in zip(scores.items(), distinct_names(list(scores)), strict=True):
        console.print(f"{folder}: {_summary(scored)}")
        write_png(options.run / f"{name}.png", sheets[folder])
    options.out.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(made, Bundle):
        write_bundle(options.out, made)
    else:
        write_exemplars(options.out, made)
    print(options.out)


def _summary(scores: Scores) -> str:
    return ", ".join(
        f"{k} {v:+.1%}" if k == "mean" else f"{k} {v:.2f}{'' if k == 'ssim' else ' dB'}"
        for k, v in scores._asdict().items()
    )
