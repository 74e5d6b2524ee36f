"""From the value of `plugin:` or `provider:` to a job type or provider.

In this order: the names of this package (names.py; Rigel's and src.plugin's lead here too), entry
points of installed packages, import paths (a module beside the Rigelfile counts, if its directory
is trusted). It is independent of job types, and imports only the requested one. Whether a class has
the interface is reported here, not when it runs: with the method and the signature it should have.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import inspect
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.installed import broken_error, find
from rigel_k8s.jobs.deploying import Deploys, HasRelease
from rigel_k8s.jobs.importing import Places, importable, is_own_name, places_of
from rigel_k8s.jobs.job import Exclusive, HasWorkloads, JobType, ProviderType
from rigel_k8s.jobs.names import BUILTIN, GROUPS, Kind, index_by_name, list_installed
from rigel_k8s.rigelfile.options import ReadsFiles, ReadsJobs
from rigel_k8s.system.trust import require_trust

#: What a job type or a provider must be, and what it may be beside that.
INTERFACES: Mapping[Kind, type[Any]] = {"job": JobType, "provider": ProviderType}
OPTIONAL: Mapping[Kind, Sequence[type[Any]]] = {
    "job": (Exclusive, ReadsFiles, ReadsJobs, Deploys, HasRelease, HasWorkloads),
    "provider": (),
}


def job_type(name: str, directory: Path | None = None) -> JobType[Any]:
    """Return the job type of that name, as resolve does."""
    found: JobType[Any] = resolve(directory, "job", name)
    return found


def provider_type(name: str, directory: Path | None = None) -> ProviderType[Any]:
    """Return the provider of that name, as resolve does."""
    found: ProviderType[Any] = resolve(directory, "provider", name)
    return found


def resolve(directory: Path | None, kind: Kind, name: str) -> Any:
    """Return the job type or provider of that name.

    Args:
        directory: the Rigelfile's directory, whose modules can be imported if it is trusted.
        kind: which of the two.
        name: a short name, an entry point's name or an import path.

    Raises:
        Untrusted: the class lies in a directory that the user has not trusted.
        UserError: the name is unknown, or the class is not a job type.
    """
    name = name.strip()
    builtin = index_by_name(kind).get(name)
    if builtin:
        return builtin.load()()
    places = places_of(directory)
    with places.left_out():
        found = find(GROUPS[kind], name)
    return _make_usable(kind, name, found or _class_at(kind, name, places))


def list_names(kind: Kind) -> dict[str, tuple[str, ...]]:
    """Return the short names that work here, each with the import paths that mean the same."""
    names = {one.short: one.paths for one in BUILTIN[kind]}
    for one in list_installed(kind):
        names.setdefault(one.short, one.paths)
    return names


def _make_usable(kind: Kind, name: str, found: Any) -> Any:
    """Return an instance of a class of the user's, or Rigel's interface wrapped in ours."""
    if not isinstance(found, type):
        raise UserError(
            f"{name} is a {type(found).__name__}, not a class",
            hint=f"write the import path of the {word(kind)}'s class: package.module.Class",
        )
    if not looks_like(found, kind):
        from rigel_k8s.jobs import rigelstyle  # few Rigelfiles name such classes

        if rigelstyle.fits(found, kind):
            adapter = rigelstyle.RigelStyleJob if kind == "job" else rigelstyle.RigelStyleProvider
            return adapter(found)
    validate(found, kind, name)
    return found()


def _class_at(kind: Kind, name: str, places: Places) -> Any:
    """Import `package.module.Class` (or `package.module:Class`)."""
    module_name, _, attribute = name.replace(":", ".").rpartition(".")
    if not all(module_name.split(".")) or is_own_name(module_name):
        raise _unknown_error(kind, name)
    beside, file = places.find(module_name) or (None, None)
    if beside:
        require_trust(beside, f"{name} would run the code in {file}")
    with importable(beside) if beside else places.left_out():
        if not _module_exists(kind, name, module_name):
            raise _unknown_error(kind, name)
        try:
            module = importlib.import_module(module_name)
        except Exception as error:
            raise broken_error(word(kind), name, error) from error
    try:
        return getattr(module, attribute)
    except AttributeError:
        raise _missing_class_error(kind, name, module_name, attribute, vars(module)) from None


def _module_exists(kind: Kind, name: str, module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError as error:
        if error.name and (module == error.name or module.startswith(f"{error.name}.")):
            return False
        raise broken_error(word(kind), name, error) from error
    except Exception as error:
        raise broken_error(word(kind), name, error) from error


def _missing_class_error(
    kind: Kind, name: str, module: str, attribute: str, present: dict[str, Any]
) -> UserError:
    known = [path for paths in list_names(kind).values() for path in paths]
    known = [path.rpartition(".")[2] for path in known if path.rpartition(".")[0] == module]
    near = difflib.get_close_matches(attribute, [*known, *present], 1)
    hint = f"did you mean {module}.{near[0]}?" if near else f"check what {module} defines"
    return UserError(f"{word(kind)} {name}: module {module} has no {attribute}", hint=hint)


def _unknown_error(kind: Kind, name: str) -> UserError:
    names = [n for short, paths in list_names(kind).items() for n in (short, *paths)]
    of_rigel = name.startswith(("rigel.plugins.", "rigel.providers."))
    # Rigel's paths are similar to each other: only a typo is close enough.
    near = difflib.get_close_matches(name, names, 1, 0.95 if of_rigel else 0.6)
    if of_rigel and not near:
        return UserError(
            f"{word(kind)} {name} is Rigel's own, and Rigel is not installed here",
            hint="install Rigel 0.3, from its repository, next to this package, or use one of: "
            + ", ".join(list_names(kind)),
        )
    meant = f", did you mean {near[0]}?" if near else ""
    return UserError(
        f'unknown {word(kind)} "{name}"{meant}',
        hint=f"use one of {', '.join(list_names(kind))}; or your own package.module.Class, which "
        "is installed or beside the Rigelfile",
    )


def looks_like(cls: type[Any], kind: Kind) -> bool:
    """Return whether the class is meant as ours: it has `options` or the method that works."""
    return hasattr(cls, "options") or (kind == "job" and hasattr(cls, "run"))


def validate(cls: type[Any], kind: Kind, name: str) -> None:
    """Raise a UserError that lists everything that does not fit in the class."""
    faults = [*_options_faults(cls), *_method_faults(cls, kind), *_constructor_faults(cls)]
    if faults:
        raise UserError(
            f"{name} is not a {word(kind)}: {faults[0]}",
            hint=_describe_interface(kind),
            details=faults[1:],
        )


def word(kind: Kind) -> str:
    """Return the kind's name for users."""
    return "job type" if kind == "job" else "provider"


def list_methods(interface: type[Any]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield the methods of an interface, with the names of their parameters."""
    for name, method in vars(interface).items():
        if inspect.isfunction(method) and not name.startswith("_"):
            yield name, tuple(inspect.signature(method).parameters)[1:]


def _describe_interface(kind: Kind) -> str:
    methods = " and ".join(_signature(*one) for one in list_methods(INTERFACES[kind]))
    return f"a {word(kind)} needs `options`, {methods}, and a constructor without arguments"


def _options_faults(cls: type[Any]) -> Iterator[str]:
    options = getattr(cls, "options", None)
    if options is None:
        yield "it has no `options`, the attrs class of what `with` may hold (or dict)"
    elif not (isinstance(options, type) and (attrs.has(options) or options is dict)):
        yield f"its `options` is {options!r}, not an attrs class (or dict)"


def _method_faults(cls: type[Any], kind: Kind) -> Iterator[str]:
    for method, parameters in list_methods(INTERFACES[kind]):
        if not callable(getattr(cls, method, None)):
            yield f"it has no method {_signature(method, parameters)}"
        else:
            yield from _find_misfit(cls, method, parameters)
    for interface in OPTIONAL[kind]:
        if issubclass(cls, interface):
            for method, parameters in list_methods(interface):
                yield from _find_misfit(cls, method, parameters)


def _find_misfit(cls: type[Any], method: str, parameters: tuple[str, ...]) -> Iterator[str]:
    """Yield a fault if the method, called on an instance, does not take these parameters."""
    static = isinstance(inspect.getattr_static(cls, method), staticmethod | classmethod)
    function = getattr(cls, method)
    try:
        signature = inspect.signature(function)
    except ValueError:  # written in C: its signature is unknown
        return
    try:
        signature.bind(*(() if static else (None,)), *parameters)
    except TypeError:
        yield f"method {method}{signature} must be {_signature(method, parameters)}"


def _constructor_faults(cls: type[Any]) -> Iterator[str]:
    try:
        inspect.signature(cls).bind()
    except TypeError:
        yield f"its constructor {cls.__name__}{inspect.signature(cls)} must not need arguments"
    except ValueError:  # written in C: its signature is unknown
        return


def _signature(method: str, parameters: tuple[str, ...]) -> str:
    return f"{method}({', '.join(('self', *parameters))})"
