"""Rigelfiles: text with places, templates, the model, and structuring into option classes.

It is independent of job types and Kubernetes: option classes are passed in, and their checks return
problems with paths, which are located in the text here.
"""

from rigel_k8s.rigelfile.check import CheckResult, check_file, find_type, load
from rigel_k8s.rigelfile.findings import (
    Finding,
    find_nearest,
    name_nearest,
    place,
    problems_error,
    render,
)
from rigel_k8s.rigelfile.grammar import render_starter
from rigel_k8s.rigelfile.model import Rigelfile
from rigel_k8s.rigelfile.options import (
    merge_options,
    preview,
    realise,
)
from rigel_k8s.rigelfile.schema import schema
from rigel_k8s.rigelfile.source import Source, Span, YamlNode, locate, strip_places
from rigel_k8s.rigelfile.structure import InvalidOptions, Structured, structure, structure_plain

__all__ = [
    "CheckResult",
    "Finding",
    "InvalidOptions",
    "Rigelfile",
    "Source",
    "Span",
    "Structured",
    "YamlNode",
    "check_file",
    "find_nearest",
    "find_type",
    "load",
    "locate",
    "merge_options",
    "name_nearest",
    "place",
    "preview",
    "problems_error",
    "realise",
    "render",
    "render_starter",
    "schema",
    "strip_places",
    "structure",
    "structure_plain",
]
