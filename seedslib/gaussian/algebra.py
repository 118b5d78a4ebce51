"""The closed class of functions, as an algebra of SymPy terms.

A term is ``polynomial x exp(quadratic) x indicator of a half-space``, the quadratic with complex
coefficients, so that sines and cosines are exponentials; beside it stands the Euclidean norm of an
affine map. A half-space may be blurred: its boundary is moved by a normal number of its own, which
makes its indicator on average the normal distribution function, hence the error function. Sums and
products of terms are terms again (at most one half-space to a term).

Reading a SymPy expression is evaluating it in the algebra: `Reader`. Functions are checked, get
real stand-ins for their symbols, and are read once: `parse`.

In front stand SymPy functions for half-spaces; their code keeps tails, and digits of known states.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, reduce
from typing import Any, NamedTuple

import numpy as np
import sympy as sp

from seedslib.base.symbols import as_expression, as_symbols, require_known, require_number


class Coded(sp.Function):
    """A function with a `plain` form in SymPy's own, which stays as it is until it is printed."""

    is_real = True

    def _eval_rewrite_as_erf(self, *args: Any, **options: Any) -> Any:
        return self.plain(*args)

    def _eval_evalf(self, prec: int) -> Any:
        return self.plain(*self.args)._eval_evalf(prec)


class NormalCDF(Coded):
    """``Phi(z)``, the probability that a standard normal number is below z.

    SymPy rewrites ``erfc(-z)`` as ``2 - erfc(z)`` at will, which loses the tail.
    """

    nargs = 1

    @classmethod
    def eval(cls, z: Any) -> Any:
        """Value at zero; nothing else is evaluated by itself."""
        return sp.S.Half if z.is_zero else None

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivative: the normal density."""
        return sp.exp(-(self.args[0] ** 2) / 2) / sp.sqrt(2 * sp.pi)

    @staticmethod
    def plain(z: Any) -> Any:
        """In terms of the error function."""
        return (1 + sp.erf(z / sp.sqrt(2))) / 2

    def _eval_evalf(self, prec: int) -> Any:
        return (sp.erfc(-self.args[0] / sp.sqrt(2)) / 2)._eval_evalf(prec)

    def _numpycode(self, printer: Any) -> str:
        erfc = printer._module_format("scipy.special.erfc")
        argument = printer._print(sp.Float(-(0.5**0.5)) * self.args[0])
        return f"(0.5*{erfc}({argument}))"


class Divisor(Coded):
    """Variance of a switching function as what is divided by, in code also where it is zero.

    What is divided is a covariance with the same function, which is zero there as well.
    """

    nargs = 1
    is_positive = True

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivative: that of the variance."""
        return sp.S.One

    @staticmethod
    def plain(variance: Any) -> Any:
        """The variance itself."""
        return variance

    def _numpycode(self, printer: Any) -> str:
        return f"(abs({printer._print(self.args[0])}) + 1e-100)"


def difference(first: Any, second: Any, rest: Any) -> Any:
    """``first - second - rest``, or zero where it is only the rounding of the first two."""
    left = first - second - rest
    return left * (abs(left) > 2.0**-48 * (abs(first) + abs(second)))


class Difference(Coded):
    """``a - b - c``, where c is what is known of ``a - b`` without subtraction."""

    nargs = 3

    def fdiff(self, argindex: int = 1) -> Any:
        """Derivatives of the difference."""
        return sp.S.One if argindex == 1 else sp.S.NegativeOne

    @staticmethod
    def plain(first: Any, second: Any, rest: Any) -> Any:
        """The difference itself."""
        return first - second - rest

    def _numpycode(self, printer: Any) -> str:
        return f"difference({', '.join(map(printer._print, self.args))})"


class NoClosedForm(ValueError):
    """The Gaussian mean of a term has no closed form in this library; the message names it."""


class Clash(ValueError):
    """Two factors that the algebra cannot multiply; the reader adds the term's name."""


class Plane(NamedTuple):
    """Half-space ``normal . x + offset > 0``; its indicator is `edge` on the boundary.

    A blurred one is ``normal . x + offset > U`` with an independent standard normal U.
    """

    normal: tuple[sp.Expr, ...]
    offset: sp.Expr
    edge: sp.Expr
    blurred: bool = False

    @property
    def place(self) -> tuple[Any, ...]:
        """The half-space without its boundary."""
        return self.normal, self.offset, self.blurred

    @property
    def boundary(self) -> frozenset[tuple[Any, ...]]:
        """Both half-spaces of the plane."""
        return frozenset((self.place, opposite(self).place))


class Key(NamedTuple):
    """What multiplies the polynomial of a term.

    ``exponent`` holds the (monomial, coefficient) pairs of degrees one and two; ``plane`` the
    half-space, if any; ``norm`` the square of a norm, a polynomial of degree two, if any.
    """

    exponent: tuple[tuple[tuple[int, ...], sp.Expr], ...] = ()
    plane: Plane | None = None
    norm: sp.Poly | None = None

    def put(
        self, quadratic: object, linear: object, number: Callable[..., Any] = lambda c: c
    ) -> None:
        """Add M (n, n) and a (n,) of the exponent ``-x'Mx/2 + a'x``, evaluated by `number`."""
        for monomial, coefficient in self.exponent:
            axes = [i for i, k in enumerate(monomial) for _ in range(k)]
            value = number(coefficient)
            if len(axes) == 1:
                linear[axes[0]] += value
            else:
                # c x_i x_j is -c on both off-diagonal places, -2c on the diagonal
                quadratic[axes[0], axes[1]] -= value
                quadratic[axes[1], axes[0]] -= value


Terms = dict[Key, sp.Poly]
PLAIN = Key()


def clean(terms: Terms) -> Terms:
    """The same sum without the terms that are zero."""
    return {key: poly for key, poly in terms.items() if not poly.is_zero}


def add_terms(left: Terms, right: Terms) -> Terms:
    """Sum of two term sums."""
    total = dict(left)
    for key, poly in right.items():
        total[key] = total[key] + poly if key in total else poly
    return clean(total)


def multiply(left: Terms, right: Terms) -> Terms:
    """Product of two term sums; `Clash` for two different half-spaces or norms."""
    total: Terms = {}
    for key_a, a in left.items():
        for key_b, b in right.items():
            if key_a.plane and key_b.plane and _disjoint(key_a.plane, key_b.plane):
                continue  # the two sides of one plane
            poly = a * b
            exponent = dict(key_a.exponent)
            for monomial, c in key_b.exponent:
                exponent[monomial] = exponent.get(monomial, sp.S.Zero) + c
            exponent = {m: sp.expand(c) for m, c in exponent.items()}
            norm = key_a.norm or key_b.norm
            if key_a.norm is not None and key_b.norm is not None:
                if key_a.norm != key_b.norm:
                    raise Clash("wanted at most one norm to a term")
                poly, norm = poly * key_a.norm, None  # a norm squared is a polynomial
            key = Key(
                tuple(sorted((m, c) for m, c in exponent.items() if c != 0)),
                _meet(key_a.plane, key_b.plane),
                norm,
            )
            total = add_terms(total, {key: poly})
    return total


def opposite(plane: Plane) -> Plane:
    """The other side of a plane."""
    return Plane(tuple(-c for c in plane.normal), -plane.offset, 1 - plane.edge, plane.blurred)


def folded(terms: Terms) -> Terms:
    """The same sum with ``p - p 1{u > 0}`` written as ``p 1{-u > 0}``, blurred or not.

    The mean of a tail then keeps its digits, which the difference from the whole would lose.
    """
    result = dict(terms)
    for key, part in terms.items():
        whole = key._replace(plane=None)
        if key.plane and whole in result and (result[whole] + part).is_zero:
            del result[whole], result[key]
            result = add_terms(result, {key._replace(plane=opposite(key.plane)): -part})
    return result


def _disjoint(left: Plane, right: Plane) -> bool:
    """Whether two half-spaces share nothing but their boundary."""
    return not left.blurred and left.place == opposite(right).place


def _meet(left: Plane | None, right: Plane | None) -> Plane | None:
    if left is None or right is None:
        return left or right
    if left.blurred or right.blurred:
        raise Clash("wanted one error function and no other switching function to a term")
    if left.place != right.place:
        raise Clash("wanted one affine switching function to a term, got two")
    return left._replace(edge=left.edge * right.edge)


def quadratic_gram(square: sp.Poly) -> sp.Matrix:
    """Gram matrix G of ``square = [1; x]' G [1; x]``, shape (n + 1, n + 1)."""
    n = len(square.gens)
    gram = sp.zeros(n + 1, n + 1)
    for monomial, c in square.terms():
        axes = [i + 1 for i, k in enumerate(monomial) for _ in range(k)]
        i, j = (*axes, 0, 0)[:2]
        gram[i, j] += c / 2
        gram[j, i] += c / 2
    return gram


def is_semidefinite(gram: sp.Matrix) -> bool:
    """Whether a matrix of numbers has no eigenvalue below rounding."""
    if gram.free_symbols:
        return False
    values = np.linalg.eigvalsh(np.array(gram.evalf().tolist(), dtype=float))
    return bool(values[0] >= -1e-12 * max(values[-1], 0.0))


class Parsed(NamedTuple):
    """A function of p values in the algebra: its own real symbols and one term sum each."""

    symbols: tuple[sp.Symbol, ...]
    parameters: tuple[sp.Symbol, ...]
    components: tuple[Terms, ...]
    scalar: bool


def components_of(f: object) -> tuple[tuple[sp.Expr, ...], bool]:
    """Components of a scalar expression, a list or a column of expressions; whether scalar."""
    if isinstance(f, sp.MatrixBase):
        if 1 not in f.shape:
            raise ValueError(f"f: wanted a scalar or a vector, got a matrix of shape {f.shape}")
        return tuple(f), False
    if isinstance(f, (list, tuple)):
        if not f:
            raise ValueError("f: wanted at least one component, got an empty list")
        return tuple(as_expression("f", item) for item in f), False
    return (as_expression("f", f),), True


def parse(f: object, variables: Sequence[sp.Symbol], parameters: Sequence[Any] = ()) -> Parsed:
    """Read a scalar or vector function of `variables`; cached by (expressions, symbols).

    Raises
    ------
    ValueError
        Repeated variables, unknown symbols in f, a complex or infinite value.
    TypeError
        Variables that are no symbols.
    NoClosedForm
        A term is outside the class.
    """
    expressions, scalar = components_of(f)
    variables, parameters = as_symbols("variables", variables), as_symbols("parameters", parameters)
    return Parsed(*_parse(expressions, variables, parameters), scalar)


def check_symbols(
    expressions: Sequence[sp.Expr],
    variables: tuple[sp.Symbol, ...],
    parameters: tuple[Any, ...] = (),
) -> None:
    """Refuse repeated or missing variables, unknown symbols and values that are not real."""
    known = (*variables, *parameters)
    if not variables or len(set(known)) < len(known):
        raise ValueError(f"variables: wanted distinct symbols, at least one, got {known}")
    require_known("f", expressions, known, f"; the variables are {known}")
    for expression in expressions:
        require_number("f", expression)


@lru_cache(maxsize=256)
def _parse(expressions: tuple, variables: tuple, parameters: tuple) -> tuple:
    check_symbols(expressions, variables, parameters)
    # real stand-ins let SymPy evaluate moduli and roots whatever the caller assumed
    real = {s: sp.Dummy(s.name, real=True) for s in (*variables, *parameters)}
    symbols = tuple(real[s] for s in variables)
    reader = Reader(symbols, {stand_in: own for own, stand_in in real.items()})
    components = []
    for expression in expressions:
        terms = folded(reader.read(expression.xreplace(real)))
        for key, poly in terms.items():
            if key.norm is not None and (key.exponent or key.plane or poly.total_degree() > 0):
                raise reader.refuse(expression, "wanted a constant multiple of a norm")
        components.append(terms)
    return symbols, tuple(real[s] for s in parameters), tuple(components)


EXPONENTIALS: dict[type, Callable[..., Any]] = {
    sp.exp: lambda e: [(1, e)],
    sp.sin: lambda e: [(-sp.I / 2, sp.I * e), (sp.I / 2, -sp.I * e)],
    sp.cos: lambda e: [(sp.S.Half, sp.I * e), (sp.S.Half, -sp.I * e)],
    sp.sinh: lambda e: [(sp.S.Half, e), (-sp.S.Half, -e)],
    sp.cosh: lambda e: [(sp.S.Half, e), (sp.S.Half, -e)],
}


class Reader:
    """Evaluates an expression of given real symbols in the algebra of terms.

    `names` maps the symbols back to the caller's own, for the messages.
    """

    def __init__(self, symbols: Sequence[sp.Symbol], names: Mapping[sp.Symbol, sp.Symbol]) -> None:
        self.symbols: tuple[Any, ...] = tuple(symbols)
        self.names = names
        self.one: Any = self.constant(sp.S.One)

    def refuse(self, node: sp.Expr, why: str) -> NoClosedForm:
        """Exception that names the term."""
        return NoClosedForm(f"no closed form for {node.xreplace(self.names)}: {why}")

    def constant(self, value: sp.Expr) -> Terms:
        """A polynomial as terms."""
        return clean({PLAIN: sp.Poly(value, *self.symbols)})

    def read(self, node: sp.Expr) -> Terms:
        """Terms of an expression; raises `NoClosedForm` naming what is outside the class."""
        try:
            return self._read(node)
        except Clash as clash:
            raise self.refuse(node, str(clash)) from None

    def _read(self, node: sp.Expr) -> Terms:
        if node.is_polynomial(*self.symbols):
            # powers in the polynomial ring: far faster than expanding the expression
            whole = node.is_Pow and node.has(*self.symbols)
            base, power = node.as_base_exp() if whole else (node, sp.S.One)
            return clean({PLAIN: sp.Poly(base, *self.symbols) ** int(power)})
        if node.is_Add:
            return self._fold(add_terms, {}, node.args)
        if node.is_Mul:
            return self._fold(multiply, self.one, node.args)
        if node.is_Pow:
            return self._power(node)
        if node.func in EXPONENTIALS:
            return self._exponential(node.func, node.args[0], node)
        if isinstance(node, (sp.erf, sp.erfc, NormalCDF)):
            return self._normal_cdf(node)
        if isinstance(node, sp.Abs):
            return self._abs(node.args[0], node)
        if isinstance(node, sp.sign):
            return self._sign(node.args[0], node)
        if isinstance(node, sp.Heaviside):
            return self._step(node.args[0], node.args[1], node)
        if isinstance(node, (sp.Max, sp.Min)) and len(node.args) == 2:
            return self._larger(node)
        if isinstance(node, sp.Piecewise):
            return self._piecewise(node)
        raise self.refuse(node, f"{node.func.__name__} is outside the closed class")

    def _fold(self, operation: Callable, start: Terms, nodes: Sequence[sp.Expr]) -> Terms:
        return reduce(lambda total, node: operation(total, self.read(node)), nodes, start)

    def _power(self, node: sp.Pow) -> Terms:
        base, power = node.as_base_exp()
        if power.is_Float and (2 * float(power)).is_integer():
            power = sp.Rational(int(2 * float(power)), 2)  # x**2.0 is meant as x**2
        if not base.has(*self.symbols):
            return self._exponential(sp.exp, power * sp.log(base), node)
        if power.is_Integer and power > 0:
            return reduce(multiply, [self.read(base)] * int(power))
        if (2 * power).is_Integer and power > 0 and base.is_polynomial(*self.symbols):
            whole = self.constant(sp.S.One)
            if power > 1:
                whole = self.read(base ** (power - sp.S.Half))
            return multiply(whole, self._norm(sp.Poly(base, *self.symbols), node))
        raise self.refuse(node, "wanted a positive integer power, or a number to a quadratic power")

    def _norm(self, square: sp.Poly, node: sp.Expr) -> Terms:
        gram = quadratic_gram(square) if square.total_degree() <= 2 else None
        if gram is None or not is_semidefinite(gram):
            raise self.refuse(node, "wanted the root of a sum of squares of affine functions")
        if gram.rank() == 1:
            # one square: its root is the modulus of an affine function
            row = next(i for i in range(gram.rows) if gram[i, i] != 0)
            coefficients = gram.row(row) / sp.sqrt(gram[row, row])
            affine = coefficients[0] + sum(
                c * x for c, x in zip(coefficients[1:], self.symbols, strict=True)
            )
            return self._abs(affine, node)
        return {Key(norm=square): self.one[PLAIN]}

    def _exponential(self, function: type, argument: sp.Expr, node: sp.Expr) -> Terms:
        inner = self.read(argument)
        poly = inner.get(PLAIN, sp.Poly(0, *self.symbols))
        if set(inner) - {PLAIN} or poly.total_degree() > 2:
            raise self.refuse(node, "wanted an exponent that is a polynomial of degree two")
        total: Terms = {}
        for coefficient, exponent in EXPONENTIALS[function](poly.as_expr()):
            parts = sp.Poly(exponent, *self.symbols).as_dict(native=False)
            free = parts.pop((0,) * len(self.symbols), sp.S.Zero)
            scale = sp.Poly(coefficient * sp.exp(free), *self.symbols)
            total = add_terms(total, {Key(tuple(sorted(parts.items()))): scale})
        return total

    def _affine(self, argument: sp.Expr, node: sp.Expr) -> sp.Poly:
        if argument.is_polynomial(*self.symbols):
            poly = sp.Poly(argument, *self.symbols)
            if poly.total_degree() <= 1:
                return poly
        raise self.refuse(
            node, f"wanted an affine switching function, got {argument.xreplace(self.names)}"
        )

    def _step(self, argument: sp.Expr, edge: sp.Expr, node: sp.Expr) -> Terms:
        """Indicator of ``argument > 0``, in a normal form that recognises equal planes.

        It is not written as one minus that of the other side, which would lose a tail.
        """
        poly = self._affine(argument, node)
        if poly.total_degree() <= 0:  # no variables, or they cancel
            return self.constant(sp.Heaviside(poly.as_expr(), edge))
        normal = [poly.coeff_monomial(x) for x in self.symbols]
        lead = next(c for c in normal if c != 0)
        # a parameter of unknown sign cannot be divided by without turning the side
        scale = abs(lead) if lead.is_positive or lead.is_negative else sp.S.One
        plane = Plane(
            tuple(c / scale for c in normal), poly.coeff_monomial(sp.S.One) / scale, sp.S(edge)
        )
        return {Key(plane=plane): self.one[PLAIN]}

    def _normal_cdf(self, node: sp.Expr) -> Terms:
        """Error functions by ``Phi(u) = E 1{u > U}`` with an independent normal number U."""
        scale = {NormalCDF: 1, sp.erf: sp.sqrt(2), sp.erfc: -sp.sqrt(2)}[node.func]
        poly = self._affine(sp.expand(node.args[0] * scale), node)
        if poly.total_degree() <= 0:
            return self.constant(node.xreplace({node.args[0]: sp.expand(node.args[0])}))
        normal = tuple(poly.coeff_monomial(x) for x in self.symbols)
        plane = Plane(normal, poly.coeff_monomial(sp.S.One), sp.S.Half, blurred=True)
        below = {Key(plane=plane): self.one[PLAIN]}
        if isinstance(node, NormalCDF):
            return below
        shift = self.constant(sp.S(-1 if isinstance(node, sp.erf) else 0))
        return add_terms(shift, multiply(self.constant(sp.S(2)), below))

    def _abs(self, argument: sp.Expr, node: sp.Expr) -> Terms:
        affine = self.constant(self._affine(argument, node).as_expr())
        return multiply(affine, self._sign(argument, node))

    def _sign(self, argument: sp.Expr, node: sp.Expr) -> Terms:
        step = self._step(argument, sp.S.Half, node)
        return add_terms(multiply(self.constant(sp.S(2)), step), self.constant(sp.S.NegativeOne))

    def _larger(self, node: sp.Expr) -> Terms:
        first, second = node.args
        gap = sp.expand(first - second if isinstance(node, sp.Max) else second - first)
        if first == 0:  # as SymPy sorts them; the other side alone keeps a tail
            return multiply(self.read(second), self._step(-gap, sp.S.Half, node))
        step = self._step(gap, sp.S.Half, node)
        return add_terms(self.read(second), multiply(self.read(sp.expand(first - second)), step))

    def _piecewise(self, node: sp.Piecewise) -> Terms:
        total, rest = self.constant(sp.S.Zero), self.one
        for value, condition in node.args:
            inside, outside = self._condition(condition, node)
            total = add_terms(total, multiply(multiply(rest, inside), self.read(value)))
            rest = multiply(rest, outside)
        if rest:
            raise self.refuse(node, "wanted a value for every x, the last condition True")
        return total

    def _condition(self, condition: sp.Basic, node: sp.Expr) -> tuple[Terms, Terms]:
        """Indicators of where a condition holds and of where it does not."""
        if condition == sp.true:
            return self.one, {}
        if isinstance(condition, (sp.Gt, sp.Ge, sp.Lt, sp.Le)):
            edge = sp.S.One if isinstance(condition, (sp.Ge, sp.Le)) else sp.S.Zero
            gap = condition.gts - condition.lts
            return self._step(gap, edge, node), self._step(-gap, 1 - edge, node)
        raise self.refuse(
            node, f"wanted one inequality to a piece, got {condition.xreplace(self.names)}"
        )
