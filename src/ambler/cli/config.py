"""`ambler config`: what a robot is told, what a key means, and whether a profile is right."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from ambler.cli.run_options import add_settings


def add_parser(subparsers: Any) -> None:
    """Add the verb and its sub-verbs."""
    text = "the configuration of a robot: show, explain, check"
    parser: argparse.ArgumentParser = subparsers.add_parser("config", help=text, description=text)
    members = parser.add_subparsers(dest="config_verb", metavar="WHAT", required=True)
    show = members.add_parser("show", help="print the whole configuration of a robot as YAML")
    _add_robot(show)
    add_settings(show)
    show.set_defaults(run=run_show)
    explain = members.add_parser("explain", help="say what a key means, its type and its value")
    explain.add_argument("key", metavar="KEY", help="such as rollout.horizon, or a section such as gate")
    _add_robot(explain)
    add_settings(explain)
    explain.set_defaults(run=run_explain)
    check = members.add_parser("check", help="say whether a profile is right, and what it changes")
    check.add_argument("file", type=Path, metavar="FILE", help="a profile")
    _add_robot(check)
    check.set_defaults(run=run_check)


def _add_robot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--robot", default="diff", help="diff, spot, amr_omni, mecanum, go2, g1 or a URDF file (default: diff)"
    )
    parser.add_argument("--known-map", action="store_true", help="as it is in a known map, instead of exploring")


def run_show(args: argparse.Namespace) -> int:
    """Print the resolved configuration."""
    import yaml

    from ambler.settings.profiles import as_values

    yaml.safe_dump(as_values(_config(args)), sys.stdout, sort_keys=False, allow_unicode=True)
    return 0


def run_explain(args: argparse.Namespace) -> int:
    """Print what is known of a key."""
    from ambler.settings.explain import explain

    found = explain(_config(args), args.key)
    print(f"{found.key}: {found.type_name}")
    print(f"value: {found.value}")
    print(f"\n{found.section}\n{found.text}")
    if found.names:
        print(f"\nkeys: {', '.join(found.names)}")
    return 0


def run_check(args: argparse.Namespace) -> int:
    """Check a profile and print what it changes."""
    from ambler.apps.config import default_config, robot_config
    from ambler.cli.run_options import take_faults
    from ambler.settings.explain import differences
    from ambler.settings.profiles import as_values, load_profile
    from ambler.sim.robots import robot_named

    model = robot_named(args.robot).model
    profile = load_profile(args.file)
    take_faults(profile)
    before, after = default_config(model, has_map=args.known_map), robot_config(model, profile, has_map=args.known_map)
    changes = differences(as_values(before), as_values(after))
    print(f"{args.file} is right for {model.name}; it changes {len(changes)} values")
    for key, old, new in changes:
        print(f"  {key}: {old} -> {new}")
    return 0


def _config(args: argparse.Namespace) -> Any:
    from ambler.apps.config import robot_config
    from ambler.cli.run_options import profile_of
    from ambler.sim.robots import robot_named

    profile, _ = profile_of(args)
    return robot_config(robot_named(args.robot).model, profile, has_map=args.known_map)
