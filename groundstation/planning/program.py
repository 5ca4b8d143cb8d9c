"""The nonlinear program behind a plan, with exact derivatives, solved by an interior point (IPOPT through CasADi).

Every iterate starts and ends at rest, because the unknowns live in the null space of the rest conditions. What the
criterion and the limits are as functions of the unknowns is in ``terms``; how an eigenvalue becomes smooth in ``lifting``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from groundstation.planning.lifting import lifting_of
from groundstation.planning.problem import Problem
from groundstation.planning.samples import LimitGroup
from groundstation.planning.terms import HeldLimit, Information

Array = NDArray[np.float64]


class Program:
    """A program ready to be solved from many starting points.

    Variables are the unknowns, the lifted variables of each vehicle, and the worst cost where there are several vehicles.

    Args:
        problem: what to optimise.
        groups: limit groups of each vehicle.
        phases: for each vehicle and limit group the phases of the base frequency at which it is held.
        warm: start the interior point close to its end, for starting points that nearly solve the program.
        watch: called with the unknowns of each iterate; KeyboardInterrupt raised in it ends the solver.
    """

    def __init__(
        self,
        problem: Problem,
        groups: Sequence[Mapping[str, LimitGroup]],
        phases: Sequence[Mapping[str, Array]],
        *,
        warm: bool = False,
        watch: Callable[[Array], None] = lambda unknowns: None,
    ) -> None:
        self.problem, self._warm, self._watch = problem, warm, watch
        vehicles = problem.vehicles[:1] if problem.criterion == "condition" else problem.vehicles
        samples = 8 * problem.harmonics
        self._information = [Information(problem, vehicle, samples) for vehicle in vehicles]
        self._lifting = lifting_of(problem.criterion, self._information[0].size)
        self._held = [
            HeldLimit(problem, each[name], phase)
            for each, at in zip(groups, phases, strict=True)
            for name, phase in at.items()
            if len(phase)
        ]
        self._scale = np.ones(len(vehicles))
        self._robust = len(vehicles) > 1
        self._split = problem.unknowns + self._lifting.count * np.arange(len(vehicles) + 1)
        self.size = int(self._split[-1]) + self._robust
        ties, costs = len(self._lifting.triangle[0]) * len(vehicles), len(vehicles) * self._robust
        held_lower = [each.lower for each in self._held]
        held_upper = [each.upper for each in self._held]
        self._lower = np.concatenate([np.zeros(ties), np.zeros(costs), *held_lower])
        self._upper = np.concatenate([np.zeros(ties), np.full(costs, np.inf), *held_upper])
        self._solver = self._build()

    def _lifted(self, variables: Array) -> list[Array]:
        return [variables[a:b] for a, b in zip(self._split[:-1], self._split[1:], strict=True)]

    def _objective(self, v: Array) -> float:
        return float(v[-1]) if self._robust else self._lifting.value(self._lifted(v)[0])[0]

    def _objective_gradient(self, v: Array) -> Array:
        self._watch(v[: self.problem.unknowns])  # asked for once an iterate
        gradient = np.zeros(self.size)
        if self._robust:
            gradient[-1] = 1.0
        else:
            gradient[self._split[0] : self._split[1]] = self._lifting.first(self._lifted(v)[0])[0]
        return gradient

    def _constraints(self, v: Array) -> Array:
        x, lifted = v[: self.problem.unknowns], self._lifted(v)
        values = [self._lifting.value(y) for y in lifted]
        tied = [
            information.value(x)[self._lifting.triangle] / scale - packed
            for information, scale, (_, packed) in zip(self._information, self._scale, values, strict=True)
        ]
        costs = [np.array([v[-1] - cost for cost, _ in values])] if self._robust else []
        return np.concatenate([*tied, *costs, *(held.value(x) for held in self._held)])

    def _constraint_jacobian(self, v: Array) -> Array:
        count = self.problem.unknowns
        x, lifted = v[:count], self._lifted(v)
        jacobian = np.zeros((len(self._lower), self.size))
        firsts, row = [self._lifting.first(y) for y in lifted], 0
        for k, (information, scale) in enumerate(zip(self._information, self._scale, strict=True)):
            rows = slice(row, row + len(self._lifting.triangle[0]))
            jacobian[rows, :count] = information.gradient(x)[self._lifting.triangle] / scale
            jacobian[rows, self._split[k] : self._split[k + 1]] = -firsts[k][1]
            row = rows.stop
        for k in range(len(lifted) * self._robust):
            jacobian[row, self._split[k] : self._split[k + 1]] = -firsts[k][0]
            jacobian[row, -1] = 1.0
            row += 1
        for held in self._held:
            jacobian[row : row + held.size, :count] = held.jacobian(x)
            row += held.size
        return jacobian

    def _jacobian_pattern(self) -> NDArray[np.bool_]:
        count = self.problem.unknowns
        pattern = np.zeros((len(self._lower), self.size), dtype=bool)
        row = 0
        for k in range(len(self._information)):
            rows = slice(row, row + len(self._lifting.triangle[0]))
            pattern[rows, :count] = True
            pattern[rows, self._split[k] : self._split[k + 1]] = self._lifting.pattern
            row = rows.stop
        for k in range(len(self._information) * self._robust):
            pattern[row, self._split[k] : self._split[k + 1]] = True
            pattern[row, -1] = True
            row += 1
        for held in self._held:
            pattern[row : row + held.size, :count] = held.pattern
            row += held.size
        return pattern

    def _lagrangian_hessian(self, v: Array, objective_weight: float, weights: Array) -> Array:
        count, ties = self.problem.unknowns, len(self._lifting.triangle[0])
        x, lifted = v[:count], self._lifted(v)
        hessian = np.zeros((self.size, self.size))
        cost_weights = -weights[ties * len(lifted) :][: len(lifted)] if self._robust else [objective_weight]
        for k, (information, y) in enumerate(zip(self._information, lifted, strict=True)):
            weight = weights[k * ties : (k + 1) * ties]
            symmetric = np.zeros((information.size, information.size))
            symmetric[self._lifting.triangle] = 0.5 * weight / self._scale[k]
            hessian[:count, :count] += information.hessian(x, symmetric + symmetric.T)
            here = slice(int(self._split[k]), int(self._split[k + 1]))
            hessian[here, here] = self._lifting.second(y, float(cost_weights[k]), -weight)
        row = ties * len(lifted) + len(lifted) * self._robust
        for held in self._held:
            hessian[:count, :count] += held.hessian(x, weights[row : row + held.size])
            row += held.size
        return hessian

    def _build(self) -> ca.Function:
        n, m = self.size, len(self._lower)
        dense = ca.Sparsity.dense
        point, none, one, rows = dense(n, 1), dense(0, 0), dense(1, 1), dense(m, 1)
        upper = np.triu_indices(n)
        order = np.lexsort(upper)

        filled = np.nonzero(self._jacobian_pattern().T)[::-1]
        sparse = ca.Sparsity.triplet(m, n, [int(i) for i in filled[0]], [int(j) for j in filled[1]])

        def triangle(hessian: Array) -> ca.DM:
            return ca.DM(ca.Sparsity.upper(n), hessian[upper][order])

        def entries(jacobian: Array) -> ca.DM:
            return ca.DM(sparse, jacobian[filled])

        self._callbacks = [
            _Callback("nlp", lambda v, p: [self._objective(v), self._constraints(v)], ("x", "p"), ("f", "g"), (point, none), (one, rows)),
            _Callback("grad_f", lambda v, p: [self._objective(v), self._objective_gradient(v)], ("x", "p"), ("f", "grad_f_x"), (point, none), (one, point)),
            _Callback("jac_g", lambda v, p: [self._constraints(v), entries(self._constraint_jacobian(v))], ("x", "p"), ("g", "jac_g_x"), (point, none), (rows, sparse)),
            _Callback("hess_lag", lambda v, p, f, g: [triangle(self._lagrangian_hessian(v, float(f[0]), g))], ("x", "p", "lam_f", "lam_g"), ("triu_hess_gamma_x_x",), (point, none, one, rows), (ca.Sparsity.upper(n),)),
        ]  # fmt: skip
        nlp, gradient, jacobian, hessian = self._callbacks
        options = {
            "print_level": 0,
            "sb": "yes",
            "max_iter": 200,
            "tol": 1e-6,
            "constr_viol_tol": 1e-9,
            "mu_strategy": "adaptive",
        }
        if self._warm:
            options |= {
                "max_iter": 60,
                "mu_strategy": "monotone",
                "mu_init": 1e-4,
                "bound_push": 1e-4,
                "bound_frac": 1e-4,
            }
        settings = {"grad_f": gradient, "jac_g": jacobian, "hess_lag": hessian, "ipopt": options}
        quiet = {"print_time": False, "error_on_fail": False, "no_nlp_grad": True, "show_eval_warnings": False}
        return ca.nlpsol("plan", "ipopt", nlp, settings | quiet)

    def solve(self, unknowns: Array, reach: float = np.inf) -> Array:
        """Unknowns at a local optimum (feasible or not: judge it by its limits).

        Args:
            unknowns: where to start; the motion must reveal every parameter a little.
            reach: how far each unknown may move (m/s, rad/s; m, rad for the start).

        Raises:
            KeyboardInterrupt: Ctrl-C came while the solver ran.
        """
        lifting, count = self._lifting, self.problem.unknowns
        matrices = [information.value(unknowns) for information in self._information]
        self._scale = np.array([np.linalg.eigvalsh(matrix)[0] for matrix in matrices])
        share = 0.999 if self._warm else 0.5
        lifts = [lifting.start(matrix / scale, share) for matrix, scale in zip(matrices, self._scale, strict=True)]
        start = np.concatenate([unknowns, *lifts])
        if self._robust:
            start = np.append(start, max(lifting.value(y)[0] for y in lifts))
        least, greatest = np.full(self.size, -np.inf), np.full(self.size, np.inf)
        least[:count], greatest[:count] = unknowns - reach, unknowns + reach
        for offset in self._split[:-1]:
            least[offset + lifting.positive] = 1e-9
        answer = self._solver(x0=start, lbx=least, ubx=greatest, lbg=self._lower, ubg=self._upper)
        if any(each.interrupted for each in self._callbacks):
            raise KeyboardInterrupt
        return np.array(answer["x"]).ravel()[:count]


class _Callback(ca.Callback):
    """A numerical function as CasADi's solvers want it."""

    def __init__(
        self,
        name: str,
        function: Callable[..., list],
        inputs: Sequence[str],
        outputs: Sequence[str],
        sparsity_in: Sequence[ca.Sparsity],
        sparsity_out: Sequence[ca.Sparsity],
    ) -> None:
        ca.Callback.__init__(self)
        self._function, self._inputs, self._outputs = function, inputs, outputs
        self._sparsity_in, self._sparsity_out = sparsity_in, sparsity_out
        self.interrupted = False
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        return self._inputs[i]

    def get_name_out(self, i: int) -> str:
        return self._outputs[i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return self._sparsity_in[i]

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._sparsity_out[i]

    def eval(self, arg: Sequence[ca.DM]) -> list:
        if not self.interrupted:
            try:
                return self._function(*[np.array(each).ravel() for each in arg])
            except KeyboardInterrupt:  # the solver would swallow it and go on; without numbers it ends at once
                self.interrupted = True
        return [ca.DM(pattern, np.full(pattern.nnz(), np.nan)) for pattern in self._sparsity_out]
