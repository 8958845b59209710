"""Every verb, and every verb of a verb, has a function that takes its options."""

from importlib import import_module
from typing import get_args, get_type_hints

import pytest

from mesoshell.cli.main import COMMANDS, VERBS


def test_every_verb_has_a_command_and_no_command_is_left_over() -> None:
    offered: list[type] = []
    for options in VERBS.values():
        several = get_args(get_type_hints(options).get("command"))
        offered += several or [options]
    assert len(offered) == len(set(offered)) and set(offered) == set(COMMANDS)


@pytest.mark.parametrize("options", COMMANDS, ids=lambda kind: f"{kind.__module__.rpartition('.')[2]}.{kind.__name__}")
def test_a_command_takes_the_options_of_its_verb(options: type) -> None:
    module, _, function = COMMANDS[options].partition(":")
    hints = get_type_hints(getattr(import_module(f"mesoshell.cli.commands.{module}"), function))
    assert list(hints.values()) == [options, type(None)]
    assert module.startswith(options.__module__.rpartition(".")[2])
