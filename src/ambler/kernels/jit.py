"""The one decorator of every kernel, and its cache.

Numba does not recompile a cached caller when a callee in another file changes, so the cache folder's name holds a hash of
all kernel sources, the Numba version and the CPU. `NUMBA_CACHE_DIR` overrides it.
"""

import hashlib
import os
from pathlib import Path

import llvmlite.binding as llvm
import numba


def cache_folder() -> Path:
    """Return the folder of this exact set of kernels on this machine."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.name.encode() + source.read_bytes())
    digest.update(f"{numba.__version__} {llvm.get_host_cpu_name()}".encode())
    root = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return root / "ambler" / "numba" / digest.hexdigest()[:16]


if "NUMBA_CACHE_DIR" not in os.environ:
    numba.config.CACHE_DIR = str(cache_folder())

jit = numba.njit(cache=True, nogil=True)
