"""The stubs, which are written by hand, say what is there."""

import ast
import inspect
from pathlib import Path

import render_gradients
from render_gradients import _native

STUBS = ast.parse((Path(render_gradients.__file__).parent / "_native.pyi").read_text())


def signature_of(function: ast.FunctionDef) -> list[tuple[str, str, str]]:
    """Name, kind and default of every argument but `self`."""
    a = function.args
    plain = [x.arg for x in a.posonlyargs + a.args]
    defaults = [""] * (len(plain) - len(a.defaults)) + [ast.unparse(d) for d in a.defaults]
    out = [(n, "positional", d) for n, d in zip(plain, defaults) if n not in ("self", "cls")]
    return out + [(x.arg, "keyword", ast.unparse(d) if d else "") for x, d in zip(a.kwonlyargs, a.kw_defaults)]


def signature_at(function: object) -> list[tuple[str, str, str]]:
    out = []
    for p in inspect.signature(function).parameters.values():
        if p.name != "self":
            kind = "keyword" if p.kind is p.KEYWORD_ONLY else "positional"
            out.append((p.name, kind, "" if p.default is p.empty else repr(p.default)))
    return out


def is_public(name: str) -> bool:
    return not name.startswith("_")


def test_stubs_have_all_names_and_nothing_else() -> None:
    written = {n.name for n in STUBS.body if isinstance(n, (ast.ClassDef, ast.FunctionDef))}
    written |= {n.target.id for n in STUBS.body if isinstance(n, ast.AnnAssign) and is_public(n.target.id)}
    assert written == {n for n in dir(_native) if is_public(n)}


def test_functions_take_what_the_stubs_say() -> None:
    functions = [n for n in STUBS.body if isinstance(n, ast.FunctionDef)]
    for stub in functions:
        assert signature_of(stub) == signature_at(getattr(_native, stub.name)), stub.name
    assert len(functions) > 4


def test_classes_have_what_the_stubs_say() -> None:
    for stub in (n for n in STUBS.body if isinstance(n, ast.ClassDef)):
        real = getattr(_native, stub.name)
        methods = [n for n in stub.body if isinstance(n, ast.FunctionDef)]
        assert {m.name for m in methods if is_public(m.name)} == {n for n in vars(real) if is_public(n)}
        for m in methods:
            marks = [ast.unparse(d) for d in m.decorator_list]
            where = f"{stub.name}.{m.name}"
            if m.name == "__new__":
                assert signature_of(m) == signature_at(real), where
            elif any("property" in mark or ".setter" in mark for mark in marks):
                assert inspect.isdatadescriptor(vars(real)[m.name]), where
            elif is_public(m.name) and "overload" not in marks:
                assert signature_of(m) == signature_at(vars(real)[m.name]), where
            elif not is_public(m.name):
                assert m.name in vars(real), where


def test_everything_is_documented() -> None:
    for name in filter(is_public, dir(_native)):
        thing = getattr(_native, name)
        assert thing.__doc__, name
        if inspect.isclass(thing):
            for member, value in vars(thing).items():
                assert not is_public(member) or value.__doc__, f"{name}.{member}"
