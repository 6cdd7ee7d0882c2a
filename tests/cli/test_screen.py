"""What is drawn over does not stay, and is kept in its order."""

from __future__ import annotations

import io

from rich.console import Console
from rich.live import Live
from rich.text import Text

from tests.cli.screen import screen


def test_what_is_printed_above_a_region_stays_and_the_region_is_drawn_over() -> None:
    file = io.StringIO()
    console = Console(file=file, force_terminal=True, width=40)
    with Live(Text("a 1\nb 1"), console=console, auto_refresh=False, transient=True) as live:
        console.print("begun")
        live.update(Text("a 2\nb 2"), refresh=True)
        console.print("[red]ended[/]")
    found = screen(file.getvalue())
    assert [line for line in found.stays if line] == ["begun", "ended"]
    assert found.drawn[-4:] == ["a 2", "b 2", "a 2", "b 2"]
    assert found.drawn.index("a 1") < found.drawn.index("b 1") < found.drawn.index("a 2")


def test_a_line_is_written_over_from_its_beginning() -> None:
    assert screen("loading …\rdone\x1b[1;31m!\x1b[0m\n").stays == ["done!ng …", ""]
