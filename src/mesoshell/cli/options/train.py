"""Options of `mesoshell train`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Options:
    """Train by the method of an experiment; a run that was stopped goes on."""

    #: The experiment: a Python file that defines `config`, which chooses the method (a generator, textures, NeRF-Tex, a surface
    #: material, a captured object), and `variant`, which makes one of a preset.
    experiment: tyro.conf.Positional[Path]
    #: What the method learns from: a folder of renders, packed, of queries, or of photographs; or a .npz of exemplars
    #: or of a fitted material.
    data: Path
    #: Folder of checkpoints and log; if it holds some, the training goes on from there.
    run: Path
    #: Length of the run in thousands of images; the experiment's if not given.
    kimg: float | None = None
    #: The experiment at another size: of pictures, networks and batches, and another length.
    preset: Literal["tiny", "mini", "small", "base", "paper"] | None = None
    #: Begin with the weights of another material's run if this one has no checkpoint yet, or of a snapshot; a run on pictures
    #: also with those of a run on textures.
    transfer: Path | None = None
    #: How a step is spread over devices.
    parallel: Literal["jit", "pmap"] = "jit"
    #: Train on many hosts: "auto" to find them in the cluster's environment, or the first host's HOST:PORT.
    coordinator: str | None = None
    #: Number of hosts, and this host's number from 0, where the cluster's environment does not tell.
    hosts: tuple[int, int] | None = None
    #: Print parameters, memory by part and steps a second expected; train nothing.
    dry_run: bool = False
