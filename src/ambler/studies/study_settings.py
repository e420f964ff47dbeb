"""The settings under which a study runs its robots: checked before anything runs, and part of the name of every result that is kept."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import yaml

from ambler.apps.scene import RunOptions, checked_scene
from ambler.core.errors import BadInputError
from ambler.nodes.steps import ExploreStep, Step


@dataclass(frozen=True, slots=True)
class StudySettings:
    """`profile` overrides the defaults of every robot of a study; `faults` go wrong beside those of its cases."""

    profile: Mapping[str, Any] = field(default_factory=dict)
    faults: tuple[str, ...] = ()

    @property
    def suffix(self) -> str:
        """The end of the name of what is made with these settings, the same for equal ones only; empty where nothing is set."""
        values = self._values()
        text = json.dumps(values, sort_keys=True, default=str)
        return f"-{hashlib.sha256(text.encode()).hexdigest()[:8]}" if values else ""

    def only(self, sections: Iterable[str]) -> StudySettings:
        """Return what is set in some sections, for what depends on nothing else."""
        return StudySettings({name: self.profile[name] for name in sections if name in self.profile})

    def applied_to(self, options: RunOptions) -> RunOptions:
        """Return the options of a run with these settings."""
        return replace(options, profile=self.profile, faults=(*self.faults, *options.faults))

    def check(self, worlds: Iterable[str], robots: Iterable[str], steps: tuple[Step, ...] = (ExploreStep(),)) -> None:
        """Raise BadInputError unless every robot can be told this for these steps in every world."""
        for world, robot in itertools.product(worlds, robots):
            checked_scene(self.applied_to(RunOptions(steps, world, robot)))

    def refuse(self, names: Iterable[str], why: str) -> None:
        """Raise BadInputError with a reason when one of these dotted names is set."""
        for name in names:
            value: Any = self.profile
            for part in name.split("."):
                value = value.get(part) if isinstance(value, Mapping) else None
            if value is not None:
                raise BadInputError(f"configuration {name}: {why}")

    def words(self, file: Path) -> tuple[str, ...]:
        """Write these settings as a profile to `file` and return the options of a command that takes it; nothing where nothing is set."""
        values = self._values()
        if not values:
            return ()
        file.write_text(yaml.safe_dump(values, sort_keys=False, allow_unicode=True), encoding="utf-8")
        return ("--profile", str(file))

    def _values(self) -> dict[str, Any]:
        """Everything, as a profile says it."""
        return {**self.profile, "faults": list(self.faults)} if self.faults else dict(self.profile)


DEFAULTS = StudySettings()
