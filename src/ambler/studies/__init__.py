"""The workshop: studies that run many robots and judge them, and benchmarks. Nothing that a robot needs stands here.

`study` conducts any campaign (cases, seeds, pools, a cache, bars); the other modules say what their cases are and how they are judged.
"""
