"""`mesoshell train`: a generator of materials, or a network that it is compared with. JAX is imported only in training, since
one of several hosts first forks the process that trains."""

from mesoshell.cli.host_process import run_in_child
from mesoshell.cli.options.train import Options
from mesoshell.errors import InputError


def run(options: Options) -> None:
    """All of `mesoshell train`."""
    if options.coordinator is not None:
        run_in_child(lambda: _train(options), options.run)
    _train(options)


def _train(options: Options) -> None:
    from mesoshell.cli.compilation_cache import keep_compiled
    from mesoshell.cli.learn import learn, print_length
    from mesoshell.measure.run_cost import run_cost
    from mesoshell.train.experiment import check_recipe, experiment_of, read_data, with_kimg
    from mesoshell.train.hosts import join

    keep_compiled()
    config, recipe = experiment_of(options.experiment, options.preset)
    config = with_kimg(config, options.kimg)
    dataset = read_data(config, options.data, options.run)
    check_recipe(options.experiment, recipe, dataset)
    if options.coordinator is not None:
        join(options.coordinator, options.hosts)
    elif options.hosts is not None:
        raise InputError("--hosts", "requires --coordinator HOST:PORT")
    if options.dry_run:
        print(run_cost(config, dataset))
        return
    print_length(options.run, learn(config, dataset, options.run, options.parallel, options.transfer))
