"""What a tuning study varies, on which cases, and what counts as better; read from a YAML file (docs/tuning.md).

Trial 0 is the defaults. The others are points of a scrambled Sobol sequence (Owen 1998), so that a study with more trials keeps the
ones it has, and each parameter is spread evenly however few trials there are.
"""

from __future__ import annotations

import itertools
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, TypeAdapter, ValidationError
from scipy.stats import qmc

from ambler.core.errors import BadInputError
from ambler.settings.profiles import load_profile, merge

Choice = str | bool | int | float
Scale = Literal["linear", "log", "integer"]


def _distinct(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(values) == 0 or len({json.dumps(v) for v in values}) != len(values):
        raise ValueError("must hold at least one value, and none twice")
    return values


Distinct = AfterValidator(_distinct)


@dataclass(frozen=True, slots=True)
class Parameter:
    """One setting of a profile: either `range` (low, high) on a `scale`, or `choices`."""

    range: tuple[float, float] | None = None
    choices: tuple[Choice, ...] | None = None
    scale: Scale = "linear"

    def problem(self) -> str | None:
        """Say what is wrong with it, or None."""
        if (self.range is None) == (self.choices is None):
            return "needs either range or choices"
        if self.choices is not None:
            return None if len(self.choices) > 1 else "needs at least two choices"
        low, high = self.range or (0.0, 0.0)
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            return "the range must be two finite numbers, the lower first"
        return "a log scale needs a positive range" if self.scale == "log" and low <= 0.0 else None

    def value(self, unit: float) -> Choice:
        """Return the value at a place in [0, 1)."""
        if self.choices is not None:
            return self.choices[min(int(unit * len(self.choices)), len(self.choices) - 1)]
        assert self.range is not None
        low, high = self.range
        if self.scale == "log":
            return float(f"{low * (high / low) ** unit:.6g}")
        if self.scale == "integer":
            return min(math.floor(low + unit * (math.floor(high) - low + 1)), math.floor(high))
        return float(f"{low + unit * (high - low):.6g}")

    def extremes(self) -> tuple[Choice, ...]:
        """Return every choice, or both ends of the range."""
        return self.choices if self.choices is not None else (self.value(0.0), self.value(1.0))


@dataclass(frozen=True, slots=True)
class Bound:
    """What a metric must keep."""

    min: float = -math.inf
    max: float = math.inf


@dataclass(frozen=True, slots=True)
class Case:
    """One run of a trial."""

    world: str
    robot: str
    seed: int

    @property
    def name(self) -> str:
        """A name that is fit for a file."""
        return f"{_file_name(self.world)}-{_file_name(self.robot)}-{self.seed}"


def _file_name(name_or_path: str) -> str:
    """Return the name itself, or a file's stem with a checksum of its path: equal stems in two folders stay apart."""
    if Path(name_or_path).name == name_or_path and not Path(name_or_path).suffix:
        return name_or_path
    return f"{Path(name_or_path).stem}_{zlib.crc32(name_or_path.encode()):08x}"


@dataclass(frozen=True, slots=True)
class TuningSpace:
    """A study. `objective` weighs metrics, each divided by its value under the defaults in the same case; a negative weight means
    that more is better; lower sums win. `constraints` must hold in every case. Of `trials` (the defaults among them) the best
    1/`halving` go on to more cases, until all cases are run. `fixed` is part of every trial's profile;
    `time_limit` is in simulated seconds."""

    parameters: Mapping[str, Parameter]
    worlds: Annotated[tuple[str, ...], Distinct] = ("office",)
    robots: Annotated[tuple[str, ...], Distinct] = ("diff",)
    seeds: Annotated[tuple[int, ...], Distinct] = (0,)
    trials: Annotated[int, Field(ge=2)] = 16
    halving: Annotated[int, Field(ge=2)] = 2
    seed: Annotated[int, Field(ge=0)] = 0
    objective: Mapping[str, float] = field(default_factory=lambda: {"path_length_m": 1.0, "sim_seconds": 1.0})
    constraints: Mapping[str, Bound] = field(default_factory=lambda: {"collisions": Bound(max=0.0)})
    fixed: Mapping[str, Any] = field(default_factory=dict)
    physics: Literal["contact", "kinematic"] = "contact"
    time_limit: Annotated[float, Field(gt=0.0)] = 3600.0

    def cases(self) -> list[Case]:
        """Return all cases; the first seed of every world and robot comes first, so that few cases still show all of them."""
        return [Case(w, r, s) for s, w, r in itertools.product(self.seeds, self.worlds, self.robots)]

    def rungs(self) -> list[int]:
        """Return how many cases the trials of each rung have run: successive halving (Jamieson and Talwalkar 2016)."""
        counts = [len(self.cases())]
        while counts[0] > len(self.worlds) * len(self.robots):
            counts.insert(0, max(len(self.worlds) * len(self.robots), math.ceil(counts[0] / self.halving)))
        return counts

    def sampled(self) -> list[dict[str, Choice]]:
        """Return the values of every trial by parameter; the first is empty: the defaults."""
        names = sorted(self.parameters)
        sobol = qmc.Sobol(len(names), rng=np.random.default_rng(self.seed))
        points = sobol.random_base2(max(1, math.ceil(math.log2(self.trials))))[: self.trials - 1]
        values = [{n: self.parameters[n].value(float(u)) for n, u in zip(names, p, strict=True)} for p in points]
        return [{}, *values]

    def profile(self, values: Mapping[str, Choice]) -> dict[str, Any]:
        """Return the nested profile of a trial."""
        profile = dict(self.fixed)
        for name, value in values.items():
            nested: Any = value
            for key in reversed(name.split(".")):
                nested = {key: nested}
            profile = merge(profile, nested)
        return profile


def load_space(path: Path) -> TuningSpace:
    """Read a study's file; raises BadInputError that names what is wrong."""
    try:
        space = TypeAdapter(TuningSpace).validate_python(_strict(load_profile(path), path))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadInputError(f"{path}: {where}: {first['msg']}") from error
    if not space.parameters:
        raise BadInputError(f"{path}: parameters: there is nothing to vary")
    for name, parameter in space.parameters.items():
        problem = parameter.problem()
        if problem is not None:
            raise BadInputError(f"{path}: parameters.{name}: {problem}")
    if not space.objective:
        raise BadInputError(f"{path}: objective: names no metric")
    return space


def _strict(values: Mapping[str, Any], path: Path) -> Mapping[str, Any]:
    known = TuningSpace.__dataclass_fields__
    for key in values:
        if key not in known:
            raise BadInputError(f"{path}: {key}: no such name; there are {', '.join(sorted(known))}")
    return values
