"""``station export``: episodes as files for training, or for a quick look."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from station import registry
from station.cli import candidates
from station.cli.fields import options_of
from station.cli.options import Decorator, NamedPath, Verbs, data_option, jobs_option, json_option, task_option
from station.errors import Interrupted, StationError, UnknownName, UsageError
from station.printable import printable

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from station.export.columns import KeyColumns
    from station.export.kind import ExportKind, Reopened, SkippedEpisode
    from station.export.run import Exported, Preview, Workers
    from station.export.shards import Outcome

_TOLD = 20  # episodes that are not in the result and are told; the rest are counted


class _Formats(Verbs):
    """One verb per registered format, made of the format's own options."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return registry.names("export")

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return _verb(_kind(cmd_name)) if cmd_name in registry.names("export") else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the format that the first word names.

        Raises:
            UnknownName: there is none.
        """
        if not args[0].startswith("-") and args[0] not in (known := registry.names("export")):
            raise UnknownName("export format", args[0], known)
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the names alone: a format is not loaded to be completed."""
        return candidates.names("export", incomplete) + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Formats"):
            formatter.write_dl([(name, _summary(name)) for name in registry.names("export")])


def _list(ctx: click.Context, _option: click.Parameter, is_asked: bool) -> None:
    if is_asked and not ctx.resilient_parsing:
        width = max((len(name) for name in registry.names("export")), default=0)
        for name in registry.names("export"):
            click.echo(f"{name:{width}}  {_summary(name)}")
        ctx.exit()


@click.group("export", cls=_Formats, subcommand_metavar="FORMAT EPISODES... --out DIR [OPTIONS]")
@click.option("--list", is_flag=True, is_eager=True, expose_value=False, callback=_list, help="List the formats.")
def command() -> None:
    """Make training data, or files for a quick look, of episodes.

    \b
    station export lerobot --task cabinet --out cabinet       every episode of a task
    station export csv latest --out look                      one episode, to look into
    station export lerobot --task cabinet --out cabinet --dry-run

    An export that is interrupted goes on where it was when it is called again. Exit code 1 when an episode could not
    be converted; the result holds all others.
    """


def _kind(name: str) -> ExportKind:
    kind: ExportKind = registry.find("export", name)
    return kind


def _summary(name: str) -> str:
    try:
        return _kind(name).summary
    except (ImportError, AttributeError) as error:  # of a third party: the others are still to be seen
        return f"cannot be loaded: {error}"


def _verb(kind: ExportKind) -> click.Command:
    """Return the verb of a format: what all have, and the format's own options."""
    fields = options_of(kind.options)
    about = "Add to what an export made in --out, as it was made; what is in it already is not added twice."

    @click.command(kind.name, help=_HELP.format(summary=kind.summary), short_help=kind.summary)
    @_of_every_format
    def verb(
        episodes: Sequence[str], out: Path | None, data: Path | None, task: tuple[str, ...], jobs: int, ray: str | None,
        dry_run: bool, as_json: bool, append: bool = False, **given: Any,
    ) -> None:  # fmt: skip
        from station.config import build
        from station.export.run import Workers, reopen
        from station.export.select import sources

        asked = fields.values(given)
        options = build(kind.options, asked, where=f"export {kind.name}")
        if out is None and (append or not dry_run):
            raise UsageError(f"export {kind.name}: say which folder to make with --out")
        chosen, where = sources(episodes, data, tasks=task), Workers(jobs=jobs, ray_address=ray)
        if out is None or dry_run:
            had = reopen(kind, out.resolve(), asked) if out is not None and append else None
            _preview(kind, chosen, options, where, as_json, had)
        else:
            _export(kind, chosen, options, out, where, as_json, asked if append else None)

    if kind.reopen is not None:
        verb.params.append(click.Option(["--append"], is_flag=True, help=about))
    verb.params.extend(fields.params)
    return verb


def _of_every_format(function: Callable[..., None]) -> Callable[..., None]:
    """Add what every format can be asked."""
    folder = NamedPath(file_okay=False, path_type=Path)
    on_ray = "Work on a Ray cluster: host:port, ray://host:port, auto, or local (extra 'ray')."
    options: list[Decorator] = [
        click.argument("episodes", nargs=-1, shell_complete=candidates.episodes),
        click.option("--out", "-o", metavar="DIR", type=folder, help="Folder to make."),
        data_option,
        task_option,
        jobs_option,
        click.option("--ray", metavar="ADDRESS", default=None, help=on_ray),
        click.option("--dry-run", is_flag=True, help="Say what would be exported, and write nothing."),
        json_option,
    ]
    for option in reversed(options):
        function = option(function)
    return function


_HELP = """{summary}

EPISODES are paths, ids, beginnings of ids, `latest`, or patterns ('2026-11-21-*'); none at all takes every episode of
the data folder."""


def _export(
    kind: ExportKind, chosen: Sequence[Any], options: Any, out: Path, where: Workers, as_json: bool,
    append: Mapping[str, Any] | None,
) -> None:  # fmt: skip
    from station.export.kind import SkippedEpisode
    from station.export.progress import progress
    from station.export.run import export

    seen: list[Outcome] = []
    try:
        with progress(len(chosen), f"export {kind.name}", is_quiet=as_json) as tell:

            def on_done(outcome: Outcome) -> None:
                seen.append(outcome)
                tell(is_lost=outcome.is_lost)

            done = export(kind, chosen, options, out, where=where, append=append, on_done=on_done)
    except KeyboardInterrupt:
        safe = sum(outcome.made is not None for outcome in seen)
        again = "; the same command goes on from there" if safe else ""
        raise Interrupted(f"interrupted; {safe} of {len(chosen)} episodes are converted and kept{again}") from None
    except StationError:
        lost = [SkippedEpisode(source=outcome.source, reason=outcome.reason) for outcome in seen if outcome.is_lost]
        _print_skipped("failed", lost if len(lost) > 1 else [])  # of one alone the error tells
        raise
    _print_skipped("failed", done.failed)
    _print_skipped("left out", done.left_out)
    _print_there(done.there)
    for note in done.facts.get("notes", ()):
        click.echo(f"note: {printable(note)}", err=True)
    if as_json:
        click.echo(msgspec.json.encode(done, enc_hook=str))
    else:
        click.echo(_result(kind, done))
    raise SystemExit(1 if done.failed else 0)


def _print_skipped(what: str, lost: Sequence[SkippedEpisode]) -> None:
    for each in lost[:_TOLD]:
        click.echo(f"{what}: {printable(each.reason)}", err=True)
    if more := lost[_TOLD:]:
        click.echo(f"{what}: {len(more)} more", err=True)


def _print_there(there: Sequence[str]) -> None:
    for episode in there[:_TOLD]:
        click.echo(f"in it already: {episode}", err=True)
    if more := there[_TOLD:]:
        click.echo(f"in it already: {len(more)} more", err=True)


def _result(kind: ExportKind, done: Exported) -> str:
    lost = [f"{len(those)} {what}" for what, those in (("failed", done.failed), ("left out", done.left_out)) if those]
    lost += [f"{len(done.there)} in it already"] if done.there else []
    kept = [f"{done.kept} of them converted before"] if done.kept else []
    added = f" added to {done.had}" if done.had else ""
    counts = "; ".join([f"{done.episodes} episode{'s' if done.episodes != 1 else ''}{added}", *kept, *lost])
    size = f"{done.size_bytes / 1e6:.1f} MB in {done.files} file{'s' if done.files != 1 else ''}"
    return (
        f"{kind.name}: {counts}; {_duration(done.seconds)} of robot time, {done.rows} rows, {size}, "
        f"in {_duration(done.took_s)}: {done.out}"
    )


def _duration(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.1f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _preview(
    kind: ExportKind, chosen: Sequence[Any], options: Any, where: Workers, as_json: bool, had: Reopened | None
) -> None:
    from station.export.columns import KeyColumns
    from station.export.progress import progress
    from station.export.run import preview

    with progress(len(chosen), "looking", is_quiet=as_json) as tell:
        seen = preview(kind, chosen, options, where=where, had=had, on_done=tell)
    if as_json:
        click.echo(json.dumps(_plain(seen)))
    else:
        for source in seen.sources:
            click.echo(f"goes in   {source.episode_id}")
        for episode in seen.there:
            click.echo(f"in it     {episode}")
        for lost in seen.left_out:
            click.echo(f"left out  {printable(lost.reason)}")
        if seen.plan is not None:
            told = kind.columns(seen.plan) if kind.columns else _columns(within(seen.plan, KeyColumns))
            for line in told:
                click.echo(f"column    {line}")
            click.echo(f"as        {json.dumps(_settings(seen.plan))}")
        for note in seen.notes[:_TOLD]:
            click.echo(f"note      {printable(note)}")
        if more := seen.notes[_TOLD:]:
            click.echo(f"note      {len(more)} more")
        click.echo(f"{len(seen.sources)} of {len(chosen)} episodes would go in; nothing was written")
    raise SystemExit(0 if seen.sources or seen.there else 1)


def _plain(seen: Preview) -> dict[str, Any]:
    return {
        "sources": msgspec.to_builtins(seen.sources),
        "left_out": msgspec.to_builtins(seen.left_out),
        "plan": msgspec.to_builtins(seen.plan, enc_hook=str),
        "notes": list(seen.notes),
        "there": list(seen.there),
    }


def within(value: Any, kind: type) -> Iterable[Any]:
    """Yield the objects of a type within a plan, in order."""
    if isinstance(value, kind):
        yield value
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            yield from within(getattr(value, name), kind)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from within(item, kind)


def _columns(found: Iterable[KeyColumns]) -> Iterable[str]:
    """Yield a line per key; a plan may name one more than once."""
    for each in {each.key: each for each in found}.values():
        yield f"{each.key} ({each.role}): {each}"


def _settings(plan: Any) -> dict[str, Any]:
    """Return what of a plan is a single value: rate, layout, codec …"""
    plain = msgspec.to_builtins(plan, enc_hook=str)
    return {name: value for name, value in plain.items() if isinstance(value, (str, int, float))}
