"""`ambler world generate KIND`: draws a place that nobody has seen; `ambler world show WORLD`: tells and draws what a world is."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any


def add_parser(subparsers: Any) -> None:
    """Add the verb."""
    text = "draw a place that nobody has seen, or show a world"
    parser: argparse.ArgumentParser = subparsers.add_parser("world", help=text, description=text)
    members = parser.add_subparsers(dest="world_verb", metavar="WHAT", required=True)
    generate: argparse.ArgumentParser = members.add_parser(
        "generate", help="draw one of a kind; `--world KIND-SEED` of every verb is the same place without a file"
    )
    generate.add_argument(
        "kind",
        metavar="KIND",
        help="office, flat, ward, warehouse, hall (100 m), corridor, yard (open sides) or campus; with three dimensions: site, garage or tunnel",
    )
    generate.add_argument("--seed", type=int, default=0, help="another place for each (default: 0)")
    generate.add_argument(
        "--day",
        type=int,
        default=0,
        help="later days have a fifth of the furniture elsewhere; `KIND-SEED-dayN` (default: 0)",
    )
    generate.add_argument("--out", type=Path, metavar="FILE", help="world file (YAML), which people may change")
    generate.add_argument("--picture", type=Path, metavar="FILE", help="picture of the plan (PNG)")
    generate.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    generate.set_defaults(run=run)
    show: argparse.ArgumentParser = members.add_parser("show", help="say what a world holds, and draw it from above")
    show.add_argument(
        "world", metavar="WORLD", help="a built-in world, a drawn one (site-17), a world or map YAML, or a picture"
    )
    show.add_argument("--picture", type=Path, metavar="FILE", help="picture from above (PNG), coloured by height")
    show.add_argument(
        "--cut",
        type=float,
        default=1000.0,
        metavar="Z",
        help="look from this height down: below roofs and upper levels",
    )
    show.add_argument("--seed", type=int, default=0, help="recorded in the result; nothing is drawn by chance")
    show.add_argument("--json", type=Path, metavar="FILE", help="write the result as JSON")
    show.set_defaults(run=run_show)


def run(args: argparse.Namespace) -> int:
    """Draw, write what was asked for, and say what it is."""
    import time

    from ambler.core.errors import BadInputError
    from ambler.evaluation.results import write_results
    from ambler.sim.generator.draw import draw_place, is_spatial
    from ambler.sim.generator.picture import save_picture
    from ambler.sim.generator.view import save_view
    from ambler.sim.generator.write import write_place

    begin = time.perf_counter()
    if args.out is not None and args.out.suffix not in (".yaml", ".yml"):
        raise BadInputError(f"--out {args.out}: a world file ends in .yaml")
    place = draw_place(args.kind, args.seed, args.day)
    x0, y0, x1, y1 = place.world.bounds()
    fields: dict[str, Any] = {
        "kind": place.kind,
        "day": place.day,
        "moved": place.moved,
        "reachable_m2": round(place.floor.area, 2),
        "width_m": round(x1 - x0, 2),
        "depth_m": round(y1 - y0, 2),
        "solids": len(place.world.solids),
        "people": len(place.world.people),
        "doors": len(place.world.doors),
    }
    if args.out is not None:
        write_place(args.out, place)
    if args.picture is not None:
        if is_spatial(place.kind):
            save_view(args.picture, place.world)
        else:
            save_picture(args.picture, place)
    print(
        f"{place.name}: {x1 - x0:.0f} x {y1 - y0:.0f} m, {place.floor.area:.0f} m² that a robot reaches,"
        f" {len(place.world.solids)} solids, {len(place.world.people)} people"
    )
    print(f"use it with --world {args.out or place.name}")
    if args.json is not None:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0


def run_show(args: argparse.Namespace) -> int:
    """Load a world, say what it holds, draw it."""
    import time

    import numpy as np

    from ambler.evaluation.results import write_results
    from ambler.sim.generator.view import save_view
    from ambler.sim.route import Route
    from ambler.sim.world_file import load_world

    begin = time.perf_counter()
    world = load_world(args.world)
    x0, y0, x1, y1 = world.bounds()
    surfaces = [m.vertices[:, 2] for m in world.meshes] + (
        [] if world.terrain is None else [world.terrain.heights.ravel()]
    )
    heights = np.concatenate([np.zeros(1), *surfaces]) if world.terrain is None else np.concatenate(surfaces)
    length = Route(world.route).length if world.route else 0.0
    fields: dict[str, Any] = {
        "world": world.name,
        "width_m": round(x1 - x0, 2),
        "depth_m": round(y1 - y0, 2),
        "solids": len(world.solids),
        "triangles": sum(len(m.triangles) for m in world.meshes),
        "has_terrain": world.terrain is not None,
        "lowest_m": round(float(heights.min()), 2),
        "highest_ground_m": round(float(heights.max()), 2),
        "people": len(world.people),
        "route_m": round(length, 1),
    }
    if args.picture is not None:
        save_view(args.picture, world, args.cut)
    route = f", a route of {length:.0f} m" if world.route else ""
    print(
        f"{world.name}: {x1 - x0:.0f} x {y1 - y0:.0f} m, ground and meshes from {heights.min():.1f} to {heights.max():.1f} m,"
        f" {len(world.solids)} solids, {len(world.people)} people{route}"
    )
    if args.json is not None:
        write_results(args.json, args.command_line, args.seed, time.perf_counter() - begin, fields)
    return 0
