"""Compile every GPU kernel to PTX, without a GPU: python compile_gpu_kernels.py [FOLDER]. Prints one line per kernel.

Needs numba-cuda with a CUDA compiler, for example `pip install 'numba-cuda[cu13]'`. Exit code 77: these are missing.
"""

from __future__ import annotations

import re
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numba import cuda, typeof
from numba.core.dispatcher import Dispatcher
from numba.cuda import dispatcher

from neuralgrasps.grasps.polar import polar_scratch
from neuralgrasps.hands.zoo import load_hand
from neuralgrasps.objects.zoo import load_object
from neuralgrasps.synthesis import gpu_kernels as kernels
from neuralgrasps.synthesis.assess import Cone
from neuralgrasps.synthesis.candidates import make_problem
from neuralgrasps.synthesis.device import slim

MISSING = 77
CAPABILITIES = ((8, 0), (9, 0))
PARAMETER_BYTES = {"8": 1, "16": 2, "32": 4, "64": 8}


def nothing(out):
    pass


def check_compiler() -> None:
    if find_spec("numba_cuda") is None:
        print("the package numba-cuda is not installed")
        sys.exit(MISSING)
    try:
        cuda.compile_ptx(nothing, (typeof(np.zeros(1)),), cc=CAPABILITIES[0])
    except Exception as failure:  # a missing library is reported in many ways
        print(f"no CUDA compiler: {str(failure).strip().splitlines()[0]}")
        sys.exit(MISSING)


def main(folder: Path | None) -> None:
    check_compiler()

    def many(*shape: int, dtype: type = np.float64, order: str = "C") -> np.ndarray:
        return np.zeros(shape, dtype, order=order)

    problem = make_problem(
        load_hand("barrett"), load_object("tomato_soup_can"), friction=0.6, torsion=0.005, contact_threshold_m=2.5e-3,
        max_penetration_m=1e-3,
    )  # fmt: skip
    hands = kernels.Approach(many(2, 4, 4), many(2, 3), many(2, 3), many(2), 1e-3, 1.0, True)
    batch = kernels.Batch(
        q_start=many(2, 3), X_OH=many(2, 4, 4), q=many(2, 3), closed=many(2, dtype=np.bool_),
        contacts=many(2, dtype=np.int32), points=many(2, 2, 3), normals=many(2, 2, 3), links=many(2, 2, dtype=np.int32),
        score=many(2), penetration=many(2), outcome=many(2, dtype=np.int8),
    )  # fmt: skip
    pair = slim(problem.arrays)
    cone = Cone(pair.com, pair.length, pair.friction, pair.torsion)

    def room_like(kind, *likes: np.ndarray):
        return kind(*(many(2, *(2,) * a.ndim, dtype=a.dtype.type, order="F") for a in likes))

    line, matrix, flags = many(2), many(2, 2), many(2, dtype=np.bool_)
    room = room_like(kernels.Room, many(2, 2, 2), line, flags, flags, matrix, matrix, line)
    work = {
        "advance_kernel": (pair, hands, room),
        "close_kernel": (pair, batch, room),
        "contact_kernel": (pair, batch, room),
        "epsilon_kernel": (cone, batch, room_like(kernels.PolarRoom, matrix, *polar_scratch(2, 8))),
        "force_kernel": (cone, batch, room_like(kernels.ForceRoom, matrix, line, line)),
        "overlap_kernel": (pair, batch, room),
    }
    todo = many(2, dtype=np.int32)
    for capability in CAPABILITIES:
        # a kernel's callees are compiled for the current GPU, of which there is none
        dispatcher.get_current_device = lambda c=capability: type("Gpu", (), {"compute_capability": c})
        for name in [n for n in dir(kernels) if n.endswith("_kernel")]:
            types = tuple(typeof(a) for a in (*work[name], todo))
            kernel = getattr(kernels, name)
            ptx, _ = cuda.compile_ptx(kernel.py_func, types, cc=capability)
            entry = ptx[ptx.index(".entry") :]
            entry = entry[: entry.index(")")]
            size = sum(PARAMETER_BYTES[bits] for bits in re.findall(r"\.param \.[a-z](\d+)", entry))
            target = re.search(r"\.target (\w+)", ptx)
            print(name, target.group(1) if target else "?", f"arguments {size} bytes")
            if folder:
                (folder / f"{name}.{target.group(1) if target else 'ptx'}.ptx").write_text(ptx)
        # numba keeps the callees for the GPU they were compiled for first
        for module in [m for name, m in sys.modules.items() if name.startswith("neuralgrasps.")]:
            for function in [f for f in vars(module).values() if isinstance(f, Dispatcher)]:
                vars(function).pop("_CUDATypingContext__dispatcher", None)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
