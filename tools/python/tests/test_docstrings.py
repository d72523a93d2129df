"""Examples in the docstrings of the installed package."""

import doctest
import importlib
import pkgutil

import numpy as np
import pytest

import intima

MODULES = [m.name for m in pkgutil.iter_modules(intima.__path__, "intima.") if m.name != "intima._intima"]


def examples(name):
    """Result of running the examples of a module."""
    return doctest.testmod(importlib.import_module(name), extraglobs={"np": np, "intima": intima})


@pytest.mark.parametrize("name", MODULES)
def test_an_example_prints_what_its_docstring_says(name):
    assert examples(name).failed == 0


def test_some_docstrings_have_examples_that_run():
    assert sum(examples(name).attempted for name in MODULES) >= 5
