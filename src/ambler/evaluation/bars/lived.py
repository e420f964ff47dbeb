"""Live runs, the runtime, and the workshop."""

from __future__ import annotations

from collections.abc import Sequence

from ambler.evaluation.bars.row import Row, all_of, at_least, at_most, every

_VERBS = ("explore", "navigate", "navigate_lost", "dock", "undock")

_DISTURBANCES = ("stalled_disk", "full_disk", "recorder_raises", "log_raises")


ROWS: Sequence[Row] = (
    Row(
        "live, simulator behind a serial line and a socket: `lab_empty`",
        "5 of 5 with proof; cable pulled at 0.8 m/s (base: watchdog 0.2 s, 3.5 m/s²): stopped within 0.5 s",
        "live.json",
        "{apart_succeeded} of {apart_runs}, {apart_collisions} collisions; pulled cable: last command that moves after "
        "{cable_commands_ended_s_max:.2f} s, standing after {cable_base_stood_s_max:.2f} s (worst of {cable_runs})",
        all_of(every("apart_", "succeeded", of=5), at_most("cable_", commands_ended_s_max=0.5, base_stood_s_max=0.5)),
    ),
    Row(
        "command period of a live robot, 50 Hz, beside an empty loop",
        "worst ≤ 40 ms over 10 min; a failing node stops it ≤ 0.2 s",
        "bench_live.json",
        "99 % {none_command_p99_ms:.1f} ms, worst {none_command_max_ms:.1f} ms in {none_command_seconds:.0f} s (empty loop {none_empty_loop_p99_ms:.1f}, "
        "{none_empty_loop_max_ms:.1f}); stopped {failure_stopped_s:.2f} s after a failure",
        all_of(at_most(none_command_max_ms=40.0, failure_stopped_s=0.2), at_least(none_command_seconds=600.0)),
    ),
    Row(
        "the same while `go2` explores a site with its whole pipeline (`plot-1`, Mid-360 at 10 Hz)",
        "99 % ≤ that of the empty loop + 10 ms, and ≤ 40 ms",
        "bench_live_site.json",
        "99 % {none_command_p99_ms:.1f} ms, worst {none_command_max_ms:.1f} ms in {none_command_seconds:.0f} s (empty loop {none_empty_loop_p99_ms:.1f})",
        all_of(
            lambda fields: fields["none_command_p99_ms"] <= fields["none_empty_loop_p99_ms"] + 10.0,
            at_most(none_command_p99_ms=40.0),
            at_least(none_command_seconds=50.0),
        ),
    ),
    Row(
        "the same: from a scan's last point to the first command that knows of it",
        "median ≤ 30 ms",
        "bench_live_site.json",
        "through local costmap, controller and gate {none_scan_to_command_median_ms:.0f} ms (99 % {none_scan_to_command_p99_ms:.0f}, {none_scans_in_motion} scans), of "
        "which {none_scan_arrival_median_ms:.0f} until it has arrived; the gate alone {none_scan_to_gate_median_ms:.0f} ms, through odometry and terrain "
        "{none_scan_to_terrain_command_median_ms:.0f} ms",
        all_of(at_most(none_scan_to_command_median_ms=30.0), at_least(none_scans_in_motion=200)),
    ),
    Row(
        "the same: what the robot's process takes of one core",
        "≤ 35 % (wished: ≤ 20 %)",
        "bench_live_site.json",
        "{none_processor_pct:.0f} % over {none_processor_seconds:.0f} s",
        all_of(at_most(none_processor_pct=35.0), at_least(none_processor_seconds=50.0)),
    ),
    Row(
        "the same in the office while the disk stalls for 5 s, is full, the recorder or the log raises: 99 % of the periods",
        "≤ 10 ms more than undisturbed in the same run",
        "bench_live_disturbed.json",
        "undisturbed {none_command_p99_ms:.1f} ms; "
        + ", ".join(f"{{{name}_command_p99_ms:.1f}}" for name in _DISTURBANCES)
        + " ms",
        all_of(
            at_most(none_command_p99_ms=40.0),
            lambda f: max(f[f"{name}_command_p99_ms"] for name in _DISTURBANCES) <= f["none_command_p99_ms"] + 10.0,
        ),
    ),
    Row(
        "time of every node on its own thread, exploring and docking",
        "99 % of its callbacks within the latency that it declares",
        "bench_nodes.json",
        "late: {offenders}; gate {office_gate_p99_ms:.2f} of {office_gate_declared_ms:.0f} ms, controller "
        "{office_controller_p99_ms:.1f} of {office_controller_declared_ms:.0f} ms, docking {dock_docking_p99_ms:.2f} of "
        "{dock_docking_declared_ms:.0f} ms (99 %)",
        lambda f: f["offenders"] == "" and f["office_gate_p99_ms"] <= 1.0,
    ),
    Row(
        "live, each verb in real time: " + ", ".join(name.replace("_", " ") for name in _VERBS),
        "10 of 10 each",
        "live.json",
        ", ".join(f"{{{name}_succeeded}}" for name in _VERBS) + " of {explore_runs} each",
        all_of(*(every(f"{name}_", "succeeded", of=10) for name in _VERBS)),
    ),
    Row(
        "calls and goals of four foreign threads while the robot drives, in both executors",
        "1000 each: all answered; in lockstep repeated to the bit",
        "bench_door.json",
        "{lockstep_answered} and {live_answered} answered, {lockstep_lost} and {live_lost} lost, {lockstep_wrong} and {live_wrong} of another question's; "
        "a call takes {lockstep_call_median_ms:.1f} and {live_call_median_ms:.1f} ms (median); repeated to the bit: {lockstep_is_replay_equal}",
        lambda f: f["bars_door"] and f["lockstep_answered"] == f["live_answered"] >= 1000,
    ),
    Row(
        "runs ended by a signal at a random instant",
        "30 of 30 leave what was known, whole",
        "interrupts.json",
        "{in_order} of {runs}; {with_map} with their map, {before_the_run} before anything was known",
        every("", "in_order", of=30),
    ),
    Row(
        "a campaign of 40 explorations on a cluster of two workers, one of them killed in the middle",
        "the table of the local pool, no case lost or told twice",
        "cluster.json",
        "{cluster_told} of {runs} cases told, {cluster_crashed} crashed, {cases_that_differ} differ from the local pool's; tables equal: {is_table_equal}",
        lambda f: f["is_table_equal"] and f["cases_that_differ"] == 0 and f["cluster_told"] == f["runs"],
    ),
    Row(
        "faults planted into the source, one by one",
        "≥ 60, each noticed by a fast test in < 60 s",
        "mutation.json",
        "{noticed} of {faults} noticed, the slowest after {slowest_seconds:.0f} s of a processor",
        all_of(every("", "noticed", "faults", of=60), at_most(slowest_seconds=60.0)),
    ),
    Row(
        "results drawn at random, their commands run again at their commits",
        "10 of 10 give the same numbers (times apart)",
        "run_again.json",
        "{equal} of {compared} equal, of {candidates} that can be run again in short time",
        lambda f: f["equal"] == f["compared"] == f["drawn"] >= 10,
    ),
    Row(
        "velocity gate: random search for a counterexample",
        "0 in 10⁷",
        "gate_search.json",
        "{counterexamples} in {cases} cases",
        all_of(at_most(counterexamples=0), at_least(cases=10**7)),
    ),
)
