"""``station completion``: what makes a shell complete our command lines."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from station.cli.options import COMPLETION_VARIABLE, PROGRAM

SHELLS = ("bash", "zsh", "fish")


@click.command("completion")
@click.argument("shell", type=click.Choice(SHELLS))
def command(shell: str) -> None:
    """Print the script that lets SHELL complete verbs, options, runbooks, episodes and other names.

    \b
    station completion bash >> ~/.bashrc                                   install it for bash 4.4 or newer
    station completion zsh >> ~/.zshrc                                     for zsh, below its compinit
    station completion fish > ~/.config/fish/completions/station.fish      for fish
    """
    made = get_completion_class(shell)
    assert made is not None
    root = click.get_current_context().find_root().command
    click.echo(made(root, {}, PROGRAM, COMPLETION_VARIABLE).source(), nl=False)
