"""Straight C for the linear algebra of one interior-point step on a fixed pattern.

Products with the blocks run over the stages of a group side by side; the Riccati recursion (Rao, Wright, Rawlings:
Application of interior-point methods to model predictive control, J. Optim. Theory Appl. 99, 1998) runs stage by
stage, with vectors along the state. Only elements of the pattern are touched.
"""

from __future__ import annotations

from collections.abc import Iterable

from planner.solver.pattern import Pattern, Place


def generate(pattern: Pattern, width: int) -> tuple[str, str]:
    """C definitions: sizes, and the functions `interior_point.h` is built on."""
    writer = _Writer(pattern, width)
    return "\n".join(writer.sizes()), "\n".join((*writer.products(), *writer.recursion()))


def _sum(terms: Iterable[str], zero: str = "0.0") -> str:
    return " + ".join(terms) or zero


ZERO = "all(0.0)"
"""of a vector"""


def _function(head: str, lines: Iterable[str]) -> str:
    return "\n".join((f"static inline {head}", "{", *(f"    {line}" for line in lines), "}"))


class _Writer:
    def __init__(self, pattern: Pattern, width: int) -> None:
        self.p, self.W = pattern, width
        self.nx, self.nu, self.rows = pattern.size.nx, pattern.size.nu, pattern.size.rows
        self.nb = len(pattern.size.bounded)
        self.V = -(-self.nx // width)
        self.A, self.B = pattern.places("A"), pattern.places("B")
        self.soft = [*((r, 1) for r in pattern.upper_sides), *((r, -1) for r in pattern.lower_sides)]
        self.hard = 2 * (self.nu + self.nb)

    def sizes(self) -> list[str]:
        """Dimensions and the table between packed elements and the blocks of a `StageQp`."""
        size = self.p.size
        values = {
            "NX": self.nx, "NU": self.nu, "ROWS": self.rows, "V": self.V, "GROUPS": -(-size.N // self.W),
            "ELEMENTS": len(self.p.elements), "NAB": len(self.A) + len(self.B), "HARD": self.hard,
            "SOFT": len(self.soft), "SIDES": self.hard + len(self.soft),
        }  # fmt: skip
        lines = [f"enum {{ {', '.join(f'{name} = {value}' for name, value in values.items())} }};"]
        lines.append(f"static const int soft_row[SOFT + 1] = {{{', '.join(str(r) for r, _ in [*self.soft, (0, 0)])}}};")
        first = [f"{name.upper()} = {self.p.index.get((name, 0, 0), 0)}" for name in ("slack_l1", "slack_l2")]
        return [*lines, f"enum {{ {', '.join(first)} }};"]

    def _d(self, array: str, i: int, j: int = 0) -> str:
        return f"d[{self.p.index[array, i, j]}]"

    def _ab(self, array: str, i: int, j: int) -> str:
        n = self.A.index((i, j)) if array == "A" else len(self.A) + self.B.index((i, j))
        return f"ab[{n}]"

    def products(self) -> list[str]:
        """Functions over the lanes of a group."""
        sides = [self._side_values(), self._side_bounds(), self._side_adjoint()]
        return [*sides, self._cost_gradient(), self._condensed()]

    def _side_values(self) -> str:
        """Left sides of all inequalities, written as value <= bound."""
        lines = []
        for r in range(self.rows):
            terms = (f"{self._d('C', r, j)} * z[{j}]" for j in self._row(r))
            lines.append(f"const vec c{r} = {_sum(terms, ZERO)};")
        values = [f"{sign}u[{i}]" for sign in "-+" for i in range(self.nu)]
        values += [f"{sign}z[{i}]" for sign in "-+" for i in self.p.size.bounded]
        values += [f"{'+' if sign > 0 else '-'}c{r}" for r, sign in self.soft]
        lines += [f"value[{n}] = {text};" for n, text in enumerate(values)]
        unused = ["(void)d;"] if not self.rows else []
        return _function("void side_values(const vec *d, const vec *z, const vec *u, vec *value)", [*unused, *lines])

    def _row(self, r: int) -> list[int]:
        return [j for i, j in self.p.places("C") if i == r]

    def _side_bounds(self) -> str:
        texts = []
        for name, n in (("u", self.nu), ("z", self.nb)):
            texts += [f"-{self._d(f'lower_{name}', i)}" for i in range(n)]
            texts += [self._d(f"upper_{name}", i) for i in range(n)]
        texts += [self._d("upper_row", r) if s > 0 else f"-{self._d('lower_row', r)}" for r, s in self.soft]
        lines = [f"bound[{n}] = {text};" for n, text in enumerate(texts)]
        return _function("void side_bounds(const vec *d, vec *bound)", lines)

    def _soft_sum(self, r: int, signed: bool) -> str:
        """Of y over the sides of a soft row."""
        parts = [(self.hard + n, s) for n, (row, s) in enumerate(self.soft) if row == r]
        return " ".join(f"{'-' if signed and s < 0 else '+'} y[{n}]" for n, s in parts) or ZERO

    def _side_adjoint(self) -> str:
        """Gradient of sum y value added to gz, gu."""
        nu, nb = self.nu, self.nb
        lines = [f"gu[{i}] += y[{nu + i}] - y[{i}];" for i in range(nu)]
        lines += [f"gz[{i}] += y[{2 * nu + nb + n}] - y[{2 * nu + n}];" for n, i in enumerate(self.p.size.bounded)]
        for r in range(self.rows):
            lines.append(f"const vec y{r} = {self._soft_sum(r, True)};")
            lines += [f"gz[{j}] += {self._d('C', r, j)} * y{r};" for j in self._row(r)]
        return _function("void side_adjoint(const vec *d, const vec *y, vec *gz, vec *gu)", lines)

    def _cost_gradient(self) -> str:
        lines = []
        for name, x, n in (("Q", "z", self.nx), ("R", "u", self.nu)):
            for i in range(n):
                places = [(max(i, j), min(i, j)) for j in range(n)]
                terms = [
                    f"{self._d(name, *place)} * {x}[{j}]" for j, place in enumerate(places)
                    if (name, *place) in self.p.index
                ]  # fmt: skip
                lines.append(f"g{x}[{i}] = {_sum([self._d(name.lower(), i), *terms])};")
        return _function("void cost_gradient(const vec *d, const vec *z, const vec *u, vec *gz, vec *gu)", lines)

    def _condensed(self) -> str:
        """Hessians of a group with the weights `y` of all sides, spread over the stages from `k` on."""
        nu, nb, bounded = self.nu, self.nb, list(self.p.size.bounded)
        lines = [f"const vec y{r} = {self._soft_sum(r, False)};" for r in range(self.rows)]
        for n, (i, j) in enumerate(self.p.hessian):
            terms = [self._d("Q", i, j)] if ("Q", i, j) in self.p.index else []
            if i == j and i in bounded:
                at = 2 * nu + bounded.index(i)
                terms += [f"y[{at}]", f"y[{at + nb}]"]
            both = [r for r in range(self.rows) if {("C", r, i), ("C", r, j)} <= self.p.index.keys()]
            terms += [f"{self._d('C', r, i)} * {self._d('C', r, j)} * y{r}" for r in both]
            lines.append(f"const vec h{n} = {_sum(terms, ZERO)};")
        corner = self._corner()
        for n, (i, j) in enumerate(corner):
            terms = [self._d("R", i, j)] if ("R", i, j) in self.p.index else []
            terms += [f"y[{i}]", f"y[{nu + i}]"] if i == j else []
            lines.append(f"const vec r{n} = {_sum(terms, ZERO)};")
        lines += [self._spread(f"h{n}", place, "H[k + l]") for n, place in enumerate(self._mirrored())]
        lines += [f"STORE(R[k + l][{n}], r{n});" for n in range(len(corner))]
        head = "void condensed(const vec *d, const vec *y, int k, Hessian *H, Corner *R)"
        return _function(head, lines)

    def _corner(self) -> list[Place]:
        return [(i, j) for i in range(self.nu) for j in range(i + 1)]

    def _mirrored(self) -> list[tuple[Place, ...]]:
        """Where each element of the condensed Hessian goes: the lower triangle, blocks on the diagonal whole."""
        W = self.W
        return [((i, j), (j, i)) if i != j and i // W == j // W else ((i, j),) for i, j in self.p.hessian]

    def _spread(self, value: str, places: tuple[Place, ...], target: str) -> str:
        return " ".join(f"STORE({target}[{j * self.V * self.W + i}], {value});" for i, j in places)

    def recursion(self) -> list[str]:
        """Functions stage by stage."""
        return [self._factor(), self._backward(), self._forward(), self._costate()]

    def _factor(self) -> str:
        """One stage back: P of the stage after -> feedback, factor of the corner, P here without its Hessian."""
        V, nx, nu = self.V, self.nx, self.nu
        lines = []
        columns = [("A", j) for j in range(nx)] + [("B", j) for j in range(nu)]
        for n, (name, j) in enumerate(columns):
            rows = [i for i, c in (self.A if name == "A" else self.B) if c == j]
            for v in range(V):
                terms = (f"P[{i}][{v}] * {self._ab(name, i, j)}" for i in rows)
                lines.append(f"g[{n}][{v}] = {_sum(terms, ZERO)};")
        lines += [f"g[{n}][{v}] = {ZERO};" for n in range(nx + nu, V * self.W) for v in range(V)]
        lines.append("transpose(g, t);")
        for u in range(nu):
            rows = [i for i, c in self.B if c == u]
            for v in range(V):
                terms = (f"t[{i}][{v}] * {self._ab('B', i, u)}" for i in rows)
                lines.append(f"const vec m{u}_{v} = {_sum(terms, ZERO)};")
        lines += self._corner_factor()
        lines += self._feedback()
        for j in range(nx):
            rows = [i for i, c in self.A if c == j]
            for v in range(j // self.W, V):
                down = " ".join(f"- y{u}_{v} * s[{u}][{j}]" for u in range(nu))
                terms = (f"t[{i}][{v}] * {self._ab('A', i, j)}" for i in rows)
                lines.append(f"P[{j}][{v}] = {_sum(terms, ZERO)} {down};")
        head = "int factor(const double *ab, const double *R, vec (*P)[V], Feedback *f)"
        return _function(head, ["vec g[V * W + NU][V], t[V * W][V];", *lines, "return 1;"])

    def _corner_factor(self) -> list[str]:
        """L D L' of R + B' P B; every pivot must be positive."""
        lines = []
        for i, j in self._corner():
            at = f"((const double *)g[{self.nx + i}])"
            terms = [f"{at}[{r}] * {self._ab('B', r, j)}" for r, c in self.B if c == j]
            lines.append(f"double e{i}{j} = {_sum([f'R[{i * (i + 1) // 2 + j}]', *terms])};")
        for j in range(self.nu):
            lines += [f"e{j}{j} -= w{j}{q} * l{j}{q};" for q in range(j)]
            lines += [f"if (!(e{j}{j} > 0.0)) return 0;", f"const double i{j} = f->inverse[{j}] = 1.0 / e{j}{j};"]
            for i in range(j + 1, self.nu):
                down = " ".join(f"- w{i}{q} * l{j}{q}" for q in range(j))
                lines.append(f"const double w{i}{j} = e{i}{j} {down}, l{i}{j} = f->L[{i}][{j}] = w{i}{j} * i{j};")
        return lines

    def _feedback(self) -> list[str]:
        """y = L^-1 B'PA, s = y over the pivots, K = -L^-T s."""
        V, nu = self.V, self.nu
        lines = [f"double s[{nu}][V * W] __attribute__((aligned(64)));"]
        for v in range(V):
            for u in range(nu):
                down = " ".join(f"- l{u}{q} * y{q}_{v}" for q in range(u))
                lines.append(f"const vec y{u}_{v} = m{u}_{v} {down}, s{u}_{v} = y{u}_{v} * i{u};")
                lines.append(f"((vec *)s[{u}])[{v}] = s{u}_{v};")
            for u in reversed(range(nu)):
                down = " ".join(f"- l{q}{u} * k{q}_{v}" for q in range(u + 1, nu))
                lines.append(f"const vec k{u}_{v} = -s{u}_{v} {down}; ((vec *)f->K[{u}])[{v}] = k{u}_{v};")
        return lines

    def _backward(self) -> str:
        """One stage back: p of the stage after -> feed-forward and p of this stage, given the gradients."""
        lines = [f"const double p{i} = p[{i}];" for i in range(self.nx)]
        lines += [f"const double g{u} = {self._pulled('B', u, f'gu[{u}]')};" for u in range(self.nu)]
        lines += self._solve_corner()
        for j in range(self.nx):
            feedback = (f"f->K[{u}][{j}] * g{u}" for u in range(self.nu))
            lines.append(f"p[{j}] = {_sum([self._pulled('A', j, f'gz[{j}]'), *feedback])};")
        gradients = "const double *gz, const double *gu"
        head = f"void backward(const double *ab, const Feedback *f, {gradients}, double *p, double *ff)"
        return _function(head, lines)

    def _pulled(self, name: str, column: int, start: str) -> str:
        """`start` plus a column of A or B times p."""
        places = self.A if name == "A" else self.B
        return _sum([start, *(f"{self._ab(name, i, j)} * p{i}" for i, j in places if j == column)])

    def _solve_corner(self) -> list[str]:
        lines = []
        for u in range(self.nu):
            down = " ".join(f"- f->L[{u}][{q}] * a{q}" for q in range(u))
            lines.append(f"const double a{u} = g{u} {down};")
        for u in reversed(range(self.nu)):
            down = " ".join(f"- f->L[{q}][{u}] * b{q}" for q in range(u + 1, self.nu))
            lines.append(f"const double b{u} = -a{u} * f->inverse[{u}] {down}; ff[{u}] = b{u};")
        return lines

    def _forward(self) -> str:
        """One stage on: change of the state before -> change of input and of the state after."""
        lines = [f"const double x{i} = x[{i}];" for i in range(self.nx)]
        for u in range(self.nu):
            terms = (f"f->K[{u}][{i}] * x{i}" for i in range(self.nx))
            lines.append(f"const double u{u} = {_sum([f'ff[{u}]', *terms])};")
            lines.append(f"u[{u}] = u{u};")
        lines += [f"next[{i}] = {self._motion(i)};" for i in range(self.nx)]
        arguments = "const double *ab, const Feedback *f, const double *ff, const double *x"
        head = f"void forward({arguments}, double *u, double *next)"
        return "\n".join((_function(head, lines), self._roll()))

    def _motion(self, row: int) -> str:
        terms = [f"{self._ab('A', i, j)} * x{j}" for i, j in self.A if i == row]
        return _sum([*terms, *(f"{self._ab('B', i, j)} * u{j}" for i, j in self.B if i == row)])

    def _roll(self) -> str:
        """One stage of the linearised motion with inputs left as they are."""
        lines = [f"const double x{i} = x[{i}];" for i in range(self.nx)]
        for row in range(self.nx):
            terms = [f"{self._ab('A', i, j)} * x{j}" for i, j in self.A if i == row]
            lines.append(f"next[{row}] = {_sum([f'b[{row}]', *terms])};")
        return _function("void roll(const double *ab, const double *b, const double *x, double *next)", lines)

    def _costate(self) -> str:
        """One stage back: multiplier of the motion, and the gradient in the inputs left over."""
        lines = [f"const double p{i} = p[{i}];" for i in range(self.nx)]
        lines += [f"left[{u}] = {self._pulled('B', u, f'gu[{u}]')};" for u in range(self.nu)]
        lines += [f"p[{j}] = {self._pulled('A', j, f'gz[{j}]')};" for j in range(self.nx)]
        head = "void costate(const double *ab, const double *gz, const double *gu, double *p, double *left)"
        return _function(head, lines)
