"""The pipeline's options on the command line, generated from their descriptions."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from typing import Annotated, Any

import typer

from gffe_cl.engine.core.errors import GffeError
from gffe_cl.engine.core.validation import require_choice
from gffe_cl.engine.options import OPTIONS, PRESETS, Option, Options

SCN = ("shading_correction", "focus_mask", "scn_model", "scn_provider")  # options of the commands that only measure


def takes_options(*names: str, **fixed: Any) -> Callable[[Callable], Callable]:
    """Return a decorator that gives a command the options `names` (all that have a flag if none are named) in place of
    its parameter `options`, an `Options`; `fixed` are values of others. A command with all that a preset sets has
    `--preset`, too."""

    def decorate(command: Callable) -> Callable:
        chosen = [OPTIONS[name] for name in names or OPTIONS if OPTIONS[name].flag and name not in fixed]
        own = [p for p in inspect.signature(command).parameters.values() if p.name != "options"]
        hints = {name: hint for name, hint in command.__annotations__.items() if name not in ("options", "return")}
        resolved = {
            name: typing.get_type_hints(_with(name, hint, command), include_extras=True)[name]
            for name, hint in hints.items()
        }
        made = [parameter for option in chosen for parameter in _parameters(option)]
        if {name for preset in PRESETS.values() for name in preset.values} <= {option.name for option in chosen}:
            made.insert(0, _PRESET)
        parameters = [p.replace(annotation=resolved[p.name]) for p in own] + made

        def with_options(context: typer.Context, **given: Any) -> Any:
            values = {p.name: given.pop(p.name) for p in made}
            preset = values.pop(_PRESET.name, _PRESET.default)
            require_choice(preset, PRESETS, "--preset")
            sources = {name: context.get_parameter_source(name) for name in values}
            said = {name for name, source in sources.items() if source is not None and source.name != "DEFAULT"}
            return command(**given, options=_options(chosen, values, said, fixed, PRESETS[preset].values))

        parameters.append(_CONTEXT)
        with_options.__signature__ = inspect.Signature(
            [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
        )
        with_options.__annotations__ = {p.name: p.annotation for p in parameters}
        with_options.__name__, with_options.__doc__ = command.__name__, command.__doc__
        return with_options

    return decorate


def _with(name: str, hint: Any, command: Callable) -> Callable:
    def holder() -> None: ...

    holder.__annotations__ = {name: hint}
    holder.__wrapped__ = command  # where the names of the annotation are looked up
    return holder


def _parameters(option: Option) -> list[inspect.Parameter]:
    """Return the parameters for typer: one, and a second for the short way to switch a module off."""
    assert option.flag is not None  # of the options that have one
    made = [_parameter(option.name, *_kind(option), option.flag, _help(option))]
    if option.off_flag:
        made.append(
            _parameter(
                f"no_{option.name}",
                bool,
                False,
                option.off_flag,
                f"Switch off {option.off_label or option.label}: the same as {option.flag} {option.off}.",
            )
        )
    return made


def _kind(option: Option) -> tuple[Any, Any]:
    """Return type and default of the command line's parameter."""
    if option.spelled:
        return str, "on" if option.default else "off"
    if option.kind is bool:
        return (bool | None, None) if option.automatic else (bool, False)
    if option.kind is str:
        return (str | None, None) if option.automatic else (str, option.default)
    if option.automatic:
        return str, option.automatic
    return option.kind, option.default


def _help(option: Option) -> str:
    if option.kind is bool and option.default is True and not option.spelled:
        return f"Switch off {option.label}: {option.sentence.partition('; off: ')[2]}"
    values = ""
    if option.spelled:
        values = "on or off"
    elif option.choices:
        values = ", ".join(option.choices)
    elif option.kind in (int, float) and not option.automatic:
        values = f"{option.low:g} to {option.high:g}"
    default = ""
    if option.kind in (bool, str) and option.automatic:
        default = f" [dim](default: {option.automatic.removeprefix('auto: ')})[/]"
    return f"{option.sentence.removesuffix('.')}{f' ({values})' if values else ''}{default}."


def _parameter(name: str, kind: Any, default: Any, flag: str, text: str) -> inspect.Parameter:
    annotation = Annotated[kind, typer.Option(flag, help=text)]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


_CONTEXT = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
_PRESET = _parameter(
    "preset",
    str,
    "balanced",
    "--preset",
    f"Preset of all options that are not given: {', '.join(PRESETS)}; balanced are the defaults.",
)


def _options(
    chosen: list[Option], values: dict[str, Any], said: set[str], fixed: dict[str, Any], preset: dict[str, Any]
) -> Options:
    """Return the options from the `values` of parameters, of which those `said` stand on the command line, and those of
    a preset where nothing is said."""
    made = dict(fixed)
    for option in chosen:
        if option.name in preset and not {option.name, f"no_{option.name}"} & said:
            made[option.name] = preset[option.name]
            continue
        value = values[option.name]
        if values.get(f"no_{option.name}"):
            value = option.off
        elif option.spelled:
            value = {"on": True, "off": False}.get(value, value)
        elif option.kind is bool and option.default is True:
            value = not value
        elif option.kind in (int, float) and isinstance(value, str):
            value = None if value == option.automatic else _number(option, value)
        try:
            made[option.name] = option.checked(value)
        except GffeError:
            raise GffeError(f"{option.flag} must be {option.expected}, got '{value}'") from None
    if made.get("shading_correction") is False:
        for name, meant in (
            ("scn_model", made.get("scn_model") is not None),
            ("focus_mask", made.get("focus_mask") is False),
        ):
            if meant:
                raise GffeError(f"--no-scn and {OPTIONS[name].flag} exclude each other")
    return Options(**made)


def _number(option: Option, text: str) -> float | int:
    try:
        return option.kind(text)
    except ValueError:
        raise GffeError(f"{option.flag} must be {option.expected}, got '{text}'") from None
