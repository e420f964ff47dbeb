"""The scan merger as a node: raw scans of all scanners and odometry in, the virtual scan and the merged cloud out."""

from __future__ import annotations

import json

from ambler.core.errors import StaleInputError
from ambler.core.messages import LaserScan, Odometry, Status
from ambler.core.se2 import SE2
from ambler.perception.merger import MergerConfig, MergeResult, ScanMerger, SourceState
from ambler.runtime import topics
from ambler.runtime.node import Node
from ambler.safety.stuck_scan import StuckScan

STARVED = "MERGER_STARVED"
SOURCE_CODES = {
    SourceState.STALE: "SCANNER_STALE",
    SourceState.SILENT: "SCANNER_SILENT",
    SourceState.NO_ODOMETRY: "SCANNER_WITHOUT_ODOMETRY",
}


class ScanMergerNode(Node):
    """Publishes `scan`, `merged_cloud`, and before each cloud the rays that met nothing, `merged_free`; tells on `status` whenever a source is dropped or comes back."""

    name = "scan_merger"
    inputs = (topics.SCANNERS, topics.ODOMETRY)
    outputs = (topics.SCAN, topics.MERGED_FREE, topics.MERGED_CLOUD, topics.STATUS)
    latency: float = 0.002
    check_period: float = 0.01

    def __init__(self, config: MergerConfig) -> None:
        self._merger = ScanMerger(config)
        self._states = {s.frame: SourceState.FRESH for s in config.scanners}
        self._repeats: dict[str, StuckScan] = {}
        self._odom_from_base = SE2()
        self._is_starved = False
        self._last_merge_ns: int | None = None

    def start(self) -> None:
        """Subscribe; the timer ends the wait for a scanner that has stopped."""
        self.ctx.subscribe(topics.ODOMETRY, self._on_odometry)
        self.ctx.subscribe(topics.SCANNERS, self._on_scan)
        self.ctx.timer(self.check_period, self._merge_if_due)

    def _on_odometry(self, odometry: Odometry) -> None:
        self._odom_from_base = odometry.pose.to_se2()
        self._merger.odometry.add(odometry)

    def _on_scan(self, scan: LaserScan) -> None:
        repeats = self._repeats.setdefault(scan.frame, StuckScan())
        if repeats.update(scan.ranges, self._odom_from_base):
            return  # not a measurement: the source grows stale and is dropped
        self._merger.add_scan(scan, self.ctx.now_ns)
        self._merge_if_due()

    def _merge_if_due(self) -> None:
        now_ns = self.ctx.now_ns
        if not self._merger.is_due(now_ns):
            max_age = self._merger.config.max_age
            if self._last_merge_ns is not None and now_ns - self._last_merge_ns > max_age * 1e9:
                self._tell_starved(f"no scanner has sent a scan in the last {max_age:g} s")
            return
        try:
            result = self._merger.merge(now_ns)
        except StaleInputError as error:
            self._tell_starved(str(error))
            return
        self._last_merge_ns = now_ns
        if self._is_starved:
            self._is_starved = False
            self._tell("MERGER_FED", "merged scans again", {})
        self.ctx.publish(topics.SCAN, result.scan)
        self.ctx.publish(topics.MERGED_FREE, result.free)
        self.ctx.publish(topics.MERGED_CLOUD, result.cloud)
        self._tell_changes(result)

    def _tell_starved(self, reason: str) -> None:
        if not self._is_starved:
            self._is_starved = True
            self._tell(STARVED, f"no merged scan: {reason}", {})

    def _tell_changes(self, result: MergeResult) -> None:
        for report in result.sources:
            before, now = self._states[report.frame], report.state
            self._states[report.frame] = now
            if now in SOURCE_CODES and now is not before:
                text = f"scanner {report.frame} is dropped from the merged scan: {now.value}"
                self._tell(SOURCE_CODES[now], text, {"frame": report.frame})
            elif now not in SOURCE_CODES and before in SOURCE_CODES:
                text = f"scanner {report.frame} is back in the merged scan"
                self._tell("SCANNER_BACK", text, {"frame": report.frame})

    def _tell(self, code: str, text: str, fields: dict[str, str]) -> None:
        self.ctx.log(code, text, **fields)
        self.ctx.publish(topics.STATUS, Status(self.ctx.now_ns, self.name, code, text, json.dumps(fields)))
