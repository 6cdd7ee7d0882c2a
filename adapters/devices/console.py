"""Talks to the person who calibrates a device."""

from __future__ import annotations

from typing import Protocol

import click


class Console(Protocol):
    """Shows lines to a person, and asks."""

    def show(self, line: str) -> None:
        """Show a line."""
        ...

    def ask(self, question: str) -> str:
        """Ask, and return the line that is typed; "" for Enter alone."""
        ...


class Terminal:
    """Talks to a person at a terminal."""

    def show(self, line: str) -> None:
        """Show a line."""
        click.echo(line)

    def ask(self, question: str) -> str:
        """Ask, and return the line that is typed; "" for Enter alone.

        Raises:
            click.Abort: it was given up.
        """
        try:
            answer: str = click.prompt(
                click.style(question, bold=True), default="", show_default=False, prompt_suffix=" "
            )
        except click.Abort:
            click.echo()  # the next words go below the question
            raise
        return answer
