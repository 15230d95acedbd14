"""Choice of the network's execution provider."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gffe_cl.engine.inference.provider_check import verdict
from gffe_cl.engine.inference.providers import CPU, NetworkError, Provider, find_provider, installed_providers

AUTO = "auto"


@dataclass(frozen=True)
class Choice:
    """Chosen provider. `may_fall_back`: the CPU may take over later; `remark`: a note for the user, "" if none."""

    provider: Provider
    may_fall_back: bool = False
    remark: str = ""


def choose(path: Path, wanted: str) -> Choice:
    """Return the provider that runs the network in the file `path`: the one named `wanted`, if it gives the CPU's
    results; "auto": the fastest of those that do. Raises NetworkError."""
    if wanted.lower() != AUTO:
        provider = find_provider(wanted)
        if provider != CPU and (problem := verdict(path, provider).problem):
            raise NetworkError(problem)
        return Choice(provider)
    found = {provider: verdict(path, provider) for provider in installed_providers() if provider != CPU}
    remark = "; ".join(each.problem for each in found.values() if each.problem and each.present)
    faster = {
        provider: each.milliseconds
        for provider, each in found.items()
        if each.passes and each.milliseconds < each.cpu_milliseconds
    }
    if faster:
        return Choice(min(faster, key=faster.__getitem__), may_fall_back=True, remark=remark)
    return Choice(CPU, remark=remark)
