"""The one decorator of every kernel, and its cache.

Numba does not recompile a cached caller when a callee in another file changes, so the cache folder's name holds a hash of
all kernel sources and the Numba version (Numba itself keys on the CPU). `NUMBA_CACHE_DIR` overrides the folder.
"""

import hashlib
import os
from importlib.metadata import version
from pathlib import Path


def cache_folder() -> Path:
    """Return the folder of this exact set of kernels."""
    digest = hashlib.sha256(version("numba").encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode() + source.read_bytes())
    root = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return root / "ambler" / "numba" / digest.hexdigest()[:16]


os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder()))

import numba  # noqa: E402  (reads NUMBA_CACHE_DIR when imported)
import numpy as np  # noqa: E402
from numpy.typing import NDArray  # noqa: E402

# Somebody may have imported Numba before the folder was named.
numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]  # type: ignore[attr-defined]


def read_only(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return an array as messages hold theirs, for a warm-up: read-only arrays are another type to the compiler."""
    array.flags.writeable = False
    return array


jit = numba.njit(cache=True, nogil=True)
# Keeps the interpreter's lock: for what takes microseconds on the way to a command. Giving the lock up for so little hands it to another thread,
# and getting it back takes a hundred times as long as the kernel. What nobody waits for lets go of it, so that others get their turn.
jit_short = numba.njit(cache=True)
# Division by zero gives inf as in IEEE 754 instead of an exception, which lets LLVM vectorise loops that divide.
jit_ieee = numba.njit(cache=True, nogil=True, error_model="numpy")
# The same with fused multiply-add: twice as fast in long polynomials over columns, equal on equal machines.
jit_fused = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
