"""HPIPM, an interior-point method for optimal-control QPs, called through ctypes from the CasADi wheel.

Frison, Diehl: HPIPM: a high-performance quadratic programming framework for model predictive control, 2020.
The wheel carries libhpipm and libblasfeo as a back end of its own; that they are there is not documented, so the
version of CasADi is pinned and `self_test` runs before they are trusted. Settings measured on the planner's problem:
partial condensing 40 -> 13 stages saves 20 to 25 %, absolute formulation, tolerance 1e-4, mu0 = 10,
cold start with `var_init_scheme` 1 (warm starts of an interior point break the loop).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hil_gateway.process.arrays import Array
from planner.solver.qp import QpStatus, StageQp
from planner.solver.self_test import check

SPEED_ABS, BALANCE = 0, 2
"""enum hpipm_mode: absolute formulation, fastest; relative formulation with refinement, for what that cannot solve"""

STATUS = {0: QpStatus.SOLVED, 1: QpStatus.ITERATION_LIMIT, 2: QpStatus.SMALL_STEP, 3: QpStatus.NOT_FINITE}
"""enum hpipm_status"""

CONDENSED_STAGES = 13
ITERATION_LIMIT = 40
TOLERANCE = 1e-4
MU0 = 10.0

_Int = ctypes.c_int
_Double = ctypes.c_double


@cache
def _library() -> ctypes.CDLL:
    """libhpipm of the CasADi wheel; its run path finds libblasfeo beside it."""
    import casadi

    return ctypes.CDLL(str(Path(casadi.__file__).parent / "libhpipm.so"))


def _size(name: str, *arguments: Any) -> int:
    function = getattr(_library(), name)
    function.restype = ctypes.c_size_t
    return int(function(*arguments))


def _block(n_bytes: int) -> Any:
    """Zeroed memory aligned to a cache line."""
    raw = ctypes.create_string_buffer(n_bytes + 64)
    aligned = ctypes.c_void_p((ctypes.addressof(raw) + 63) // 64 * 64)
    aligned._keep = raw  # type: ignore[attr-defined]
    return aligned


class _Object:
    """One HPIPM structure with its memory; `create(*dims, struct, memory)`."""

    def __init__(self, kind: str, *dims: Any) -> None:
        self.memory = _block(_size(f"d_{kind}_memsize", *dims))
        self.pointer = _block(_size(f"d_{kind}_strsize") if hasattr(_library(), f"d_{kind}_strsize") else 256)
        getattr(_library(), f"d_{kind}_create")(*dims, self.pointer, self.memory)


def _ints(values: Sequence[int]) -> Any:
    return (_Int * len(values))(*values)


class _Pointers:
    """`double **` argument: address of the block of each stage, null where a stage has none."""

    def __init__(self, arrays: Sequence[Array | None]) -> None:
        self._keep = arrays
        self.table = (ctypes.c_void_p * len(arrays))(*(None if a is None else a.ctypes.data for a in arrays))


class HpipmSolver:
    """HPIPM with partial condensing on one `StageQp`; all memory is allocated here, once."""

    name = "hpipm"

    def __init__(self, qp: StageQp, condensed_stages: int = CONDENSED_STAGES) -> None:
        self.qp, self.iterations = qp, 0
        self._condensed_stages = condensed_stages
        self._lib = _library()
        self._create()

    def _create(self) -> None:
        qp, condensed_stages = self.qp, self._condensed_stages
        self._make_qp(qp)
        self._make_condensed(min(condensed_stages, qp.size.N))
        self._methods = [self._make_method(mode) for mode in (SPEED_ABS, BALANCE)]
        self._set_all = self._bind_data()
        self._get_all = self._bind_solution()
        self._set_masks()

    def solve(self) -> QpStatus:
        lib, full, part = self._lib, self._full.pointer, self._part.pointer
        lib.d_ocp_qp_set_all(*self._set_all)
        lib.d_part_cond_qp_cond(full, part, self._cond_arg.pointer, self._cond_ws.pointer)
        self.iterations = 0
        for method in self._methods:
            status = self._attempt(*method)
            if status is QpStatus.SOLVED:
                return status
        if status is QpStatus.NOT_FINITE:
            self._create()  # NaN stays in the solver's memory and would spoil every later solve
        return status

    def _attempt(self, arg: _Object, workspace: _Object) -> QpStatus:
        """Interior-point iterations on the condensed QP, result into the arrays of the `StageQp`."""
        lib, full, part = self._lib, self._full.pointer, self._part.pointer
        lib.d_ocp_qp_ipm_solve(part, self._part_sol.pointer, arg.pointer, workspace.pointer)
        lib.d_part_cond_qp_expand_sol(
            full, self._part_sol.pointer, self._full_sol.pointer, self._cond_arg.pointer, self._cond_ws.pointer
        )
        lib.d_ocp_qp_sol_get_all(*self._get_all)
        lib.d_ocp_qp_ipm_get_status(workspace.pointer, ctypes.byref(self._status))
        lib.d_ocp_qp_ipm_get_iter(workspace.pointer, ctypes.byref(self._iter))
        self.iterations += self._iter.value
        # status 0 with NaN in the solution has been seen: the numbers have the last word
        if not np.isfinite(self.qp.du).all() or not np.isfinite(self.qp.dz).all():
            return QpStatus.NOT_FINITE
        return STATUS.get(self._status.value, QpStatus.INFEASIBLE)

    def _make_qp(self, qp: StageQp) -> None:
        """Full QP: stage 0 has no state (it is given), stage N no input."""
        size, N = qp.size, qp.size.N
        nb = len(size.bounded)
        self._dim = _Object("ocp_qp_dim", N)
        self._lib.d_ocp_qp_dim_set_all(
            _ints([0] + [size.nx] * N),
            _ints([size.nu] * N + [0]),
            _ints([0] + [nb] * N),
            _ints([size.nu] * N + [0]),
            _ints([0] + [size.rows] * N),
            _ints([0] + [size.rows] * N),
            self._dim.pointer,
        )
        self._full = _Object("ocp_qp", self._dim.pointer)
        self._full_sol = _Object("ocp_qp_sol", self._dim.pointer)
        self._status, self._iter = _Int(0), _Int(0)

    def _make_condensed(self, stages: int) -> None:
        N = self.qp.size.N
        sizes = (_Int * (stages + 1))()
        self._part_dim = _Object("ocp_qp_dim", stages)
        self._cond_arg = _Object("part_cond_qp_arg", stages)
        self._lib.d_part_cond_qp_arg_set_default(self._cond_arg.pointer)
        self._lib.d_part_cond_qp_compute_block_size(N, stages, sizes)
        self._lib.d_part_cond_qp_compute_dim(self._dim.pointer, sizes, self._part_dim.pointer)
        self._part = _Object("ocp_qp", self._part_dim.pointer)
        self._part_sol = _Object("ocp_qp_sol", self._part_dim.pointer)
        self._cond_ws = _Object(
            "part_cond_qp_ws", self._dim.pointer, sizes, self._part_dim.pointer, self._cond_arg.pointer
        )

    def _make_method(self, mode: int) -> tuple[_Object, _Object]:
        """Arguments and workspace of the interior-point method in one of its modes."""
        arg = _Object("ocp_qp_ipm_arg", self._part_dim.pointer)
        lib = self._lib
        lib.d_ocp_qp_ipm_arg_set_default(mode, arg.pointer)
        for name, integer in (("iter_max", ITERATION_LIMIT), ("var_init_scheme", 1), ("warm_start", 0)):
            getattr(lib, f"d_ocp_qp_ipm_arg_set_{name}")(ctypes.byref(_Int(integer)), arg.pointer)
        for name in ("tol_stat", "tol_eq", "tol_ineq", "tol_comp"):
            getattr(lib, f"d_ocp_qp_ipm_arg_set_{name}")(ctypes.byref(_Double(TOLERANCE)), arg.pointer)
        lib.d_ocp_qp_ipm_arg_set_mu0(ctypes.byref(_Double(MU0)), arg.pointer)
        return arg, _Object("ocp_qp_ipm_ws", self._part_dim.pointer, arg.pointer)

    def _blocks(self, array: Array) -> list[Array | None]:
        return [self.qp.stage(array, k) for k in range(self.qp.size.N)]

    def _bind_data(self) -> tuple[Any, ...]:
        """Arguments of `d_ocp_qp_set_all`, which reads the arrays of the `StageQp` at every call."""
        qp, size, N = self.qp, self.qp.size, self.qp.size.N
        zeros = np.zeros(size.nx * max(size.nx, size.nu, size.rows, 1))
        intervals = {"A": qp.A, "B": qp.B, "b": qp.b}
        inputs = {"R": qp.R, "r": qp.r, "lbu": qp.lower_u, "ubu": qp.upper_u}
        stages = {
            "Q": qp.Q, "q": qp.q, "lbx": qp.lower_z, "ubx": qp.upper_z, "C": qp.C, "lg": qp.lower_row,
            "ug": qp.upper_row, "Zl": qp.slack_l2, "Zu": qp.slack_l2, "zl": qp.slack_l1, "zu": qp.slack_l1,
        }  # fmt: skip
        pointers = {name: _Pointers(self._blocks(a)) for name, a in intervals.items()}
        pointers |= {name: _Pointers([*self._blocks(a), zeros]) for name, a in inputs.items()}
        pointers |= {name: _Pointers([zeros, *self._blocks(a)]) for name, a in stages.items()}
        pointers |= {name: _Pointers([zeros] * (N + 1)) for name in ("S", "D", "ls", "us")}
        nb = len(size.bounded)
        indices = {
            "idxbu": _ints(list(range(size.nu))),
            "idxbx": _ints(list(size.bounded)),
            "idxs": _ints([size.nu + nb + i for i in range(size.rows)]),
            "idxs_last": _ints([nb + i for i in range(size.rows)]),
        }
        self._keep = (pointers, indices, zeros)

        def table(name: str, last: str | None = None) -> Any:
            address = [ctypes.cast(indices[name], ctypes.c_void_p)] * N
            return (ctypes.c_void_p * (N + 1))(*(*address, ctypes.cast(indices[last or name], ctypes.c_void_p)))

        order = (
            "A", "B", "b", "Q", "S", "R", "q", "r", "idxbx", "lbx", "ubx", "idxbu", "lbu", "ubu", "C", "D", "lg", "ug",
            "Zl", "Zu", "zl", "zu", "idxs", "idxs_rev", "ls", "us",
        )  # fmt: skip
        tables = {"idxbx": table("idxbx"), "idxbu": table("idxbu"), "idxs": table("idxs", "idxs_last")}
        tables["idxs_rev"] = None
        return (*(tables[n] if n in tables else pointers[n].table for n in order), self._full.pointer)

    def _bind_solution(self) -> tuple[Any, ...]:
        """Arguments of `d_ocp_qp_sol_get_all`; what is not asked for goes to scratch."""
        qp, N = self.qp, self.qp.size.N
        scratch = np.zeros(16 * (qp.size.nx + qp.size.nu + qp.size.rows + 4))
        u, x = _Pointers([*self._blocks(qp.du), scratch]), _Pointers([scratch, *self._blocks(qp.dz)])
        rest, rows = _Pointers([scratch] * (N + 1)), _Pointers([scratch, *self._blocks(qp.multiplier)])
        self._keep_solution = (u, x, rest, rows)
        # u, x, ls, us, pi, lam_lb, lam_ub, lam_lg, lam_ug, lam_ls, lam_us
        return (self._full_sol.pointer, u.table, x.table, *([rest.table] * 6), rows.table, rest.table, rest.table)

    def _set_masks(self) -> None:
        """Switch off the absent sides of soft rows and the slacks that belong to them."""
        lower, upper = (np.ascontiguousarray(m) for m in (self.qp.mask_lower, self.qp.mask_upper))
        for k in range(1, self.qp.size.N + 1):
            for name, mask in (("lg", lower), ("ug", upper), ("lls", lower), ("lus", upper)):
                function = getattr(self._lib, f"d_ocp_qp_set_{name}_mask")
                function(k, mask.ctypes.data_as(ctypes.c_void_p), self._full.pointer)


@cache
def self_test() -> None:
    """Solve a small QP of known optimum.

    Raises:
        RuntimeError: the library answers wrongly.
        OSError, AttributeError: the library or a function of it is missing.
    """
    check(lambda qp: HpipmSolver(qp, condensed_stages=2))
