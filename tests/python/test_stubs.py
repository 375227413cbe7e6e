import ast
from pathlib import Path

import fnopt


def names(body):
    """The public names that statements of a stub define."""
    found = set()
    for node in body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        elif isinstance(node, ast.AnnAssign):
            found.add(node.target.id)
    return {name for name in found if not name.startswith("_")}


def public(of):
    return {name for name in vars(of) if not name.startswith("_")}


def test_the_stubs_are_of_what_is_there():
    stub = ast.parse((Path(fnopt.__file__).parent / "__init__.pyi").read_text())
    assert names(stub.body) == set(fnopt.__all__) - {"__version__"}
    for node in stub.body:
        if isinstance(node, ast.ClassDef) and node.name != "NonFiniteError":
            of = getattr(fnopt, node.name)
            assert names(node.body) == public(of), node.name
            # Each says what it is.
            assert of.__doc__ and all(getattr(of, name).__doc__ for name in public(of))
    assert (Path(fnopt.__file__).parent / "py.typed").exists()


def test_signatures_of_functions_and_methods_are_those_of_the_stubs():
    stub = ast.parse((Path(fnopt.__file__).parent / "__init__.pyi").read_text())
    for node in stub.body:
        functions = [node] if isinstance(node, ast.FunctionDef) else getattr(node, "body", [])
        for function in functions:
            if not isinstance(function, ast.FunctionDef) or function.name.startswith("_"):
                continue
            of = fnopt if function is node else getattr(fnopt, node.name)
            text = getattr(getattr(of, function.name), "__text_signature__", None)
            if text is not None:
                given = [a.arg for a in function.args.args + function.args.kwonlyargs if a.arg != "self"]
                found = [part.split("=")[0].strip(" $/*") for part in text.strip("()").split(",")]
                found = [name for name in found if name and name not in ("self", "fields")]
                assert found == [name for name in given if name != "fields"], function.name
