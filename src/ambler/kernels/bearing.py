"""The direction of a point as a fraction of a turn: odd minimax polynomials that LLVM turns into vector instructions."""

import numpy as np

from ambler.kernels.jit import jit_fused

ONE, HALF, QUARTER, ZERO, TINY = (np.float32(v) for v in (1.0, 0.5, 0.25, 0.0, 1e-30))
C1, C3, C5, C7 = np.float32(0.15915432), np.float32(-0.05302624), np.float32(0.03152512), np.float32(-0.02106151)
C9, C11, C13 = np.float32(0.01267249), np.float32(-0.00534827), np.float32(0.00108413)


@jit_fused
def turn_of(y, x):
    """Return atan2(y, x) / (2 pi) in [-0.5, 0.5], exact to 2e-9 turns (odd polynomial on Chebyshev nodes)."""
    ax, ay = abs(x), abs(y)
    z = min(ax, ay) / max(ax, ay, 1e-30)
    s = z * z
    a = 0.0004402677
    a = a * s - 0.0025037060
    a = a * s + 0.0067064111
    a = a * s - 0.0118679530
    a = a * s + 0.0168996617
    a = a * s - 0.0225964970
    a = a * s + 0.0318180526
    a = a * s - 0.0530511756
    a = a * s + 0.1591549402
    a *= z
    a = 0.25 - a if ay > ax else a
    a = 0.5 - a if x < 0.0 else a
    return -a if y < 0.0 else a


@jit_fused
def turn_of_single(y, x):
    """Return atan2(y, x) / (2 pi) in [-0.5, 0.5] as float32, exact to 1e-7 turns; `y`, `x` are float32."""
    ax, ay = abs(x), abs(y)
    z = min(ax, ay) / max(ax, ay, TINY)
    s = z * z
    a = z * (C1 + s * (C3 + s * (C5 + s * (C7 + s * (C9 + s * (C11 + s * C13))))))
    a = QUARTER - a if ay > ax else a
    a = HALF - a if x < ZERO else a
    return -a if y < ZERO else a


def warm_up() -> None:
    """Compile every kernel of this module with its real types."""
    turn_of(1.0, 2.0)
    turn_of_single(ONE, HALF)
