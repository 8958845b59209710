"""`mesoshell dataset render-patches`: queries of a mesostructure, traced by Mitsuba."""

from mesoshell.cli.checks import at_least
from mesoshell.cli.options.dataset import RenderPatches
from mesoshell.cli.queries import write_queries
from mesoshell.datasets.queries.render import Settings, of_geometry
from mesoshell.datasets.queries.sources import source
from mesoshell.errors import InputError


def run(options: RenderPatches) -> None:
    """All of `mesoshell dataset render-patches`."""
    at_least(options, patches=1, queries=1, spp=1, seed=0)
    if options.depth is not None and not 0 < options.depth <= 1:
        raise InputError("--depth", f"must be above 0 and at most 1, not {options.depth}")
    tile = source(options.source, options.depth)
    settings = Settings(options.source, tile.depth, options.curvature, options.queries, options.spp, options.seed)
    write_queries(settings, of_geometry(tile, options.spp), options.patches, options.out)
