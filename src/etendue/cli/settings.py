"""Settings of methods as options of the commands: ``--max-depth 5`` is ``-D max_depth=5``, ``--aovs`` is ``-D
aovs=true``. Their help and completion are made from the classes of settings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from typer.core import TyperCommand

from etendue.core import OptionError, suggest

from .console import output_console
from .options import parse_pairs

#: Classes of settings by method; a function, since they are imported when they are needed.
SettingsOf = Callable[[], Mapping[str, Any]]
#: Options that may be given without a name behind them, and the name that is meant.
_UNNAMED = {"--ambient": "fuzzy", "--hierarchy": ""}


def with_settings(settings_of: SettingsOf, default: str | None = None) -> type[TyperCommand]:
    """The class of a command that has the settings of these methods as options. Its help shows those of the method that
    is named by ``-m``, and otherwise those of the ``default`` method, or those that all methods have."""

    class Command(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            own = {word for known in self.get_params(ctx) for word in (*known.opts, *known.secondary_opts)}
            ctx.meta["words"] = list(args)
            parsed: list[str] = super().parse_args(ctx, list(_rewritten(list(args), own, settings_of, default)))
            return parsed

        def format_help(self, ctx: Any, formatter: Any) -> None:
            super().format_help(ctx, formatter)
            _show_settings(settings_of(), ctx.meta.get("words", []), default)

        def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
            found: list[Any] = super().shell_complete(ctx, incomplete)
            if incomplete.startswith("--") and found:
                names = {name for kind in settings_of().values() for name in kind.names()}
                found += [type(found[0])(f"--{name.replace('_', '-')}") for name in sorted(names)]
            return [item for item in found if item.value.startswith(incomplete)]

    return Command


def settings_in(define: list[str] | None) -> dict[str, Any]:
    """The settings of ``-D``, as which also those given as options arrive. Raises :class:`OptionError`."""
    pairs: dict[str, Any] = dict(parse_pairs(define, "-D"))
    if "pyramid_depth" in pairs:  # what has a depth is there
        pairs.setdefault("pyramid", "true")
    return pairs


def _rewritten(words: list[str], own: set[str], settings_of: SettingsOf, default: str | None) -> Iterator[str]:
    """The words of a command, with settings as ``-D`` and with the names that are meant where none are given. Raises
    :class:`OptionError` for an option that neither the command nor a method has."""
    kinds: dict[str, str] | None = None
    waiting = iter(range(len(words)))
    for k in waiting:
        word = words[k]
        option, equals, value = word.partition("=")
        if not option.startswith("--") or option in own or len(option) < 4:
            yield word
            if word in own and word in _UNNAMED and _is_alone(words, k):
                yield _UNNAMED[word]
            continue
        if kinds is None:
            kinds = _kinds(settings_of(), _method_in(words, default))
        name = option[2:].replace("-", "_")
        if name.startswith("no_") and name[3:] in kinds and not equals:
            yield from ("-D", f"{name[3:]}=false")
        elif name not in kinds:
            known = [*(o for o in own if o.startswith("--")), *(f"--{name.replace('_', '-')}" for name in kinds)]
            hint = suggest(option, sorted(known))
            raise OptionError(f"there is no option '{option}'; {hint if hint.startswith('did') else '-h lists them'}")
        elif equals or kinds[name] == "bool":
            yield from ("-D", f"{name}={value or 'true'}")
        elif k + 1 == len(words):
            raise OptionError(f"{option} needs a value")
        else:
            yield from ("-D", f"{name}={words[next(waiting)]}")


def _method_in(words: list[str], default: str | None) -> str | None:
    """The method that is named, or the default one."""
    return next((words[k + 1] for k, word in enumerate(words[:-1]) if word in ("-m", "--method")), default)


def _kinds(methods: Mapping[str, Any], named: str | None) -> dict[str, str]:
    """The types of all settings, where methods differ that of the ``named`` method."""
    found = {name: kind for settings in methods.values() for name, kind, _, _ in settings.describe()}
    if named is not None and named in methods:
        found |= {name: kind for name, kind, _, _ in methods[named].describe()}
    return found


def _is_alone(words: list[str], k: int) -> bool:
    """Whether no name follows the option at ``k``: what is a source is none."""
    return k + 1 == len(words) or words[k + 1].startswith("-") or is_source(words[k + 1])


def is_source(word: str) -> bool:
    """Whether a word is a file, a folder or a bundled scene."""
    from pathlib import Path

    from etendue.scene import bundled

    path = Path(word)
    return bool(path.suffix) or path.exists() or len(path.parts) > 1 or word in bundled()


def _show_settings(methods: Mapping[str, Any], words: list[str], named: str | None) -> None:
    from rich.markup import escape
    from rich.panel import Panel
    from rich.table import Table

    named = _method_in(words, named)
    kinds = [methods[named]] if named is not None and named in methods else list(methods.values())
    names = [name for name in kinds[0].names() if all(name in kind.names() for kind in kinds)]
    table = Table(box=None, show_header=False, pad_edge=False)
    for name, kind, default, doc in kinds[0].describe():
        if name in names:
            shown = "" if default in ("", None) else f" [{str(default).lower() if kind == 'bool' else default}]"
            option = f"--{name.replace('_', '-')}"
            table.add_row(f"[bold cyan]{option}", "" if kind == "bool" else escape(kind), escape(doc + shown))
    title = f"Settings of {named}" if named in methods else "Settings of all methods; -m NAME -h shows those of one"
    output_console().print(Panel(table, title=title, title_align="left", border_style="dim"))
