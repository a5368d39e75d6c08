"""Small deliberate mistakes in the syntax tree of a module, found and made in a fixed order.

Kinds: another operator (``+`` for ``-``, ``*`` for ``/``, a swapped matrix product), a negated comparison, a
constant that is doubled or one larger, a lost minus or ``not``, swapped arguments, cosine for sine, index 1
for 0, the other truth value. A comparison is negated (``<`` to ``>=``) and not shifted (``<`` to ``<=``):
between measured numbers the shifted one is the same function.

Left alone, because no test of results can see it: docstrings and other text, type hints, decorators,
assertions, what stands behind ``raise`` or goes to the log, arguments that change no number (``strict`` of
`zip`, tolerances for rounding, which triangle is factorised), folders that are made or may be there (without
it a job stops, and no number changes), rounds of an iteration beyond those that it needs, one more point on a
grid that is searched, which random numbers are drawn, -2 for -1 where a number stands for none, sizes of what
is held in memory at once, what fills an array without elements, and guards against a division by zero.
"""

import ast
import copy
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Final

OPERATORS: Final[dict[type[ast.operator], type[ast.operator]]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
COMPARISONS: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
FUNCTIONS: Final = {
    "cos": "sin",
    "sin": "cos",
    "min": "max",
    "max": "min",
    "argmin": "argmax",
    "argmax": "argmin",
    "floor": "ceil",
    "ceil": "floor",
    "minimum": "maximum",
    "maximum": "minimum",
    "any": "all",
    "all": "any",
    "deg2rad": "rad2deg",
    "rad2deg": "deg2rad",
    "ppf": "isf",
    "isf": "ppf",
    "mean": "median",
    "median": "mean",
    "zeros": "ones",
    "ones": "zeros",
}
SYMMETRIC: Final = {
    "hypot",
    "maximum",
    "minimum",
    "clip",
    "max",
    "min",
    "isinstance",
    "outer",
    "logical_and",
    "array_equal",
    "allclose",
    "isclose",
    "corrcoef",
    "fmin",
    "fmax",
    "broadcast_shapes",
    "union1d",
    "intersect1d",
    "angles_between",
    "same_heights",
    "print",
    "setattr",
    "column",
    "getattr",
}
"""Functions whose first two arguments may be exchanged, or fail at once if they are."""
SHAPES: Final = {"zeros", "ones", "empty", "eye", "range", "reshape", "field", "broadcast_to", "tile"}
"""Functions whose arguments are sizes."""
GRIDS: Final = {"linspace", "geomspace"}
"""Functions whose third argument is a number of points; where it is a size, all fails at once."""
IDLE_FLAGS: Final = {
    "strict",
    "copy",
    "ignore_index",
    "check_finite",
    "kw_only",
    "frozen",
    "slots",
    "cache",
    "sort",
    "safe",
    "init",
    "repr",
    "atol",
    "rtol",
    "rcond",
    "tol",
    "xtol",
    "ftol",
    "gtol",
    "xatol",
    "fatol",
    "max_nfev",
    "maxiter",
    "max_iterations",
    "lower",
    "workers",
    "leafsize",
    "chunksize",
    "row_group_size",
    "overwrite_a",
    "overwrite_b",
    "parents",
    "exist_ok",
    "missing_ok",
    "ignore_errors",
    "indent",
    "allow_nan",
    "ensure_ascii",
    "allow_unicode",
    "sort_keys",
    "allow_pickle",
    "errcheck",
    "stacklevel",
    "propagate",
    "optimize",
    "hermitian",
    "use_gpu",
    "num_threads",
    "print_summary",
    "extract_colors",
}
"""Arguments that change no number where the input is right: flags, and tolerances for rounding.

``ignore_index`` numbers the rows of tables that are put together anew: no value, and not in files.
"""
UNSEEN: Final = re.compile(
    r"(?i)(chunk|block|buffer|version|bytes|workers|threads|rounds|iterations|steps|seed)$"
)
"""Ends of the names of constants that say how work is cut, how long it may take, or what is drawn."""
TINY: Final = 1e-6
"""A number up to this, within a comparison or `max`, guards against a division by zero."""
LOGGERS: Final = {"debug", "info", "warning", "error", "exception", "warn"}


@dataclass(frozen=True, slots=True)
class Site:
    """One mistake: number of the node in the order of the walk, kind, line, function."""

    node: int
    kind: str
    line: int
    function: str


def sites(source: str) -> list[Site]:
    """All mistakes that can be made in a module, in the order of its text."""
    return [
        Site(number, kind, node.lineno, function)
        for number, (node, function) in enumerate(_nodes(source))
        for kind in _kinds(node)
    ]


def in_words(source: str, site: Site) -> str:
    """What is changed into what, on one line."""
    node = _nodes(source)[site.node][0]
    return f"{_short(ast.unparse(node))} -> {_short(ast.unparse(_changed(copy.deepcopy(node), site.kind)))}"


def mutated(source: str, site: Site) -> ast.Module:
    """The tree of a module with one mistake."""
    tree = ast.parse(source)
    node = next(node for number, (node, _) in enumerate(_walk(tree)) if number == site.node)
    new = _changed(node, site.kind)
    if new is not node:
        _put(tree, node, new)
    return ast.fix_missing_locations(tree)


@cache
def _nodes(source: str) -> tuple[tuple[ast.expr | ast.stmt, str], ...]:
    """What `_walk` gives of a module, parsed once; not to be changed."""
    return tuple(_walk(ast.parse(source)))


def _short(text: str, most: int = 90) -> str:
    line = " ".join(text.split())
    return line if len(line) <= most else line[: most - 3] + "..."


def _walk(tree: ast.Module) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    """Statements and expressions that may be changed, with the function around them."""
    todo: list[tuple[ast.AST, str]] = [(tree, "")]
    while todo:
        node, function = todo.pop()
        if _left_alone(node):
            continue
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            function = f"{function}.{node.name}" if function else node.name
            children: list[ast.AST] = list(node.body)
            if isinstance(node, ast.FunctionDef):
                children = [*_defaults(node.args), *children]
        elif isinstance(node, ast.AnnAssign):
            children = [node.value] if node.value and not _unseen(node, node.value) else []
        else:
            if isinstance(node, ast.expr | ast.AugAssign):
                yield node, function
            children = [child for child in ast.iter_child_nodes(node) if not _unseen(node, child)]
        todo += [(child, function) for child in reversed(children)]


def _defaults(of: ast.arguments) -> Iterator[ast.expr]:
    """Values of arguments that are not given, but for those of which no test of results can see a change."""
    plain = [*of.posonlyargs, *of.args]
    pairs = [*zip(plain[len(plain) - len(of.defaults) :], of.defaults, strict=True)]
    pairs += [(arg, value) for arg, value in zip(of.kwonlyargs, of.kw_defaults, strict=True) if value]
    yield from (value for arg, value in pairs if not UNSEEN.search(arg.arg))


def _left_alone(node: ast.AST) -> bool:
    if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Global):
        return True
    if isinstance(node, ast.keyword) and node.arg in IDLE_FLAGS:
        return True
    if isinstance(node, ast.keyword) and isinstance(node.value, ast.Constant):
        return bool(UNSEEN.search(node.arg or ""))  # as the value of such a name elsewhere
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return True
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return True
    if isinstance(node, ast.Assign) and any(
        isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets
    ):
        return True
    if isinstance(node, ast.Call) and _name(node.func).endswith(("Error", "Warning")):
        return True
    call = node.value if isinstance(node, ast.Expr) else None
    if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute):
        return call.func.attr in LOGGERS
    return False


def _unseen(node: ast.AST, child: ast.AST) -> bool:
    """Whether no test of results can see a change of a child, or all fail at once (sizes, places)."""
    if isinstance(node, ast.UnaryOp) and isinstance(child, ast.Constant):
        return child.value == 1 and type(child.value) is int  # any negative number stands for none
    if isinstance(node, ast.For) and child is node.iter:
        return isinstance(node.target, ast.Name) and node.target.id == "_"  # rounds of an iteration
    if isinstance(node, ast.Assign | ast.AnnAssign) and child is node.value:
        names = [node.target] if isinstance(node, ast.AnnAssign) else node.targets
        return any(
            (isinstance(name, ast.Name) and UNSEEN.search(name.id))
            or (isinstance(name, ast.Attribute) and name.attr in IDLE_FLAGS)
            for name in names
        )
    if isinstance(node, ast.Call) and _name(node.func) == "default_rng":
        return child is not node.func  # other numbers of the same distribution
    if isinstance(node, ast.Call) and _name(node.func) in GRIDS:
        return child in node.args[2:] and isinstance(child, ast.Constant)
    if isinstance(node, ast.Call) and _name(node.func) == "where" and isinstance(child, ast.Constant):
        match node.args:  # what is divided by where there is nothing to divide
            case [ast.Compare(left=left, ops=[ast.Gt()]), value, ast.Constant(value=1.0)]:
                return child is node.args[2] and ast.dump(left) == ast.dump(value)
    compared = isinstance(node, ast.Call) and _name(node.func) in {"max", "maximum"}
    if isinstance(child, ast.Constant) and (compared or isinstance(node, ast.Compare)):
        return type(child.value) is float and 0.0 < child.value <= TINY
    if isinstance(node, ast.Dict):  # options of an optimiser
        keys = [
            key.value
            for key, value in zip(node.keys, node.values, strict=True)
            if value is child and isinstance(key, ast.Constant)
        ]
        return any(key in IDLE_FLAGS for key in keys)
    if isinstance(node, ast.Call) and _name(node.func) == "connected_components":  # weakly: the same parts
        return isinstance(child, ast.keyword) and child.arg == "directed"
    if isinstance(node, ast.Call) and _name(node.func) == "cho_factor":
        return isinstance(child, ast.Constant)
    if isinstance(node, ast.Subscript) and child is node.slice:
        return all(
            isinstance(n, ast.Constant | ast.Slice | ast.Tuple | ast.UnaryOp | ast.USub | ast.Load)
            for n in ast.walk(child)
        )
    if isinstance(node, ast.Call) and _name(node.func) in SHAPES:
        return child is not node.func and all(
            isinstance(n, ast.Constant | ast.Tuple | ast.Call | ast.Name | ast.Attribute | ast.Load)
            for n in ast.walk(child)
        )
    return isinstance(node, ast.keyword) and node.arg == "axis"


def _kinds(node: ast.AST) -> Iterator[str]:
    """What can be changed about a node itself."""
    match node:
        case ast.BinOp(left=left, op=ast.MatMult(), right=right):
            if ast.dump(left) != ast.dump(right) and not _quadratic(left, right):
                yield "swapped product"
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
            if not any(
                isinstance(side, ast.List | ast.Tuple | ast.JoinedStr) or _text(side)
                for side in (left, right)
            ):
                yield "operator"
        case ast.AugAssign(op=op, value=value) if type(op) in OPERATORS and not _text(value):
            yield "operator"
        case ast.Compare(ops=[op]) if type(op) in COMPARISONS:
            yield "comparison"
        case ast.BoolOp():
            yield "and/or"
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            yield "sign"
        case ast.Subscript(slice=ast.Constant(value=0 | 1 as value)) if type(value) is int:
            yield "index"
        case ast.Constant(value=bool()):
            yield "truth"
        case ast.Constant(value=int() | float()):
            yield "constant"
        case ast.Call(func=func, args=args):
            name = _name(func)
            if name in FUNCTIONS and not (name in {"zeros", "ones"} and _without_elements(args)):
                yield "function"
            if name == "sqrt" and len(args) == 1:
                yield "root"
            plain = len(args) >= 2 and not any(isinstance(a, ast.Constant | ast.Starred) for a in args[:2])
            if plain and name not in SYMMETRIC and ast.dump(args[0]) != ast.dump(args[1]):
                yield "arguments"
        case _:
            return


def _without_elements(args: list[ast.expr]) -> bool:
    """Whether an array of this shape has no elements, so that ones in it are zeros."""
    sizes = args[0].elts if args and isinstance(args[0], ast.Tuple) else args[:1]
    return any(
        isinstance(size, ast.Constant) and type(size.value) is int and not size.value for size in sizes
    )


def _quadratic(left: ast.expr, right: ast.expr) -> bool:
    """Whether a product is ``x M x`` or ``x solve(M, x)``: the number of two vectors in either order."""
    match left, right:
        case ast.BinOp(left=first, op=ast.MatMult()), _:
            return ast.dump(first) == ast.dump(right)
        case _, ast.Call(args=[_, last, *_]):
            return _name(right.func) in {"solve", "cho_solve"} and ast.dump(last) == ast.dump(left)
    return False


def _text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)


def _name(func: ast.expr) -> str:
    return func.attr if isinstance(func, ast.Attribute) else func.id if isinstance(func, ast.Name) else ""


def _changed(node: ast.AST, kind: str) -> ast.AST:
    """Change a node in place; returns what is to stand there now."""
    new: ast.AST = node
    match node, kind:
        case ast.BinOp(), "swapped product":
            node.left, node.right = node.right, node.left
        case ((ast.BinOp() | ast.AugAssign()), "operator"):
            node.op = OPERATORS[type(node.op)]()
        case ast.Compare(), "comparison":
            node.ops = [COMPARISONS[type(node.ops[0])]()]
        case ast.BoolOp(), "and/or":
            node.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        case ast.UnaryOp(), "sign":
            new = node.operand
        case ast.Subscript(slice=ast.Constant(value=int() as value)), "index":
            node.slice = ast.Constant(1 - value)
        case ast.Constant(value=value), "truth":
            node.value = not value
        case ast.Constant(value=int() as value), "constant":
            node.value = value + 1
        case ast.Constant(value=float() as value), "constant":
            node.value = 2 * value if value else 1.0
        case ast.Call(func=func), "function":
            if isinstance(func, ast.Attribute):
                func.attr = FUNCTIONS[func.attr]
            elif isinstance(func, ast.Name):
                func.id = FUNCTIONS[func.id]
        case ast.Call(args=args), "root":
            new = args[0]
        case ast.Call(args=args), "arguments":
            args[0], args[1] = args[1], args[0]
        case _:
            raise ValueError(f"no {kind} at {ast.unparse(node)}")
    return new


def _put(tree: ast.Module, old: ast.AST, new: ast.AST) -> None:
    for parent in ast.walk(tree):
        for name, value in ast.iter_fields(parent):
            if value is old:
                setattr(parent, name, new)
                return
            if isinstance(value, list) and old in value:
                value[value.index(old)] = new
                return
