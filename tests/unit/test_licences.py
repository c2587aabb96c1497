"""NOTICE, CITATION.cff and LICENSE say what pyproject.toml and the installed packages say."""

from __future__ import annotations

import re
import tomllib
from importlib import metadata
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
STATED = dict(re.findall(r"^([a-z][\w.-]+)(?: \(Pinocchio\))? {2,}(\S.*)$", (ROOT / "NOTICE").read_text(), re.M))


@pytest.mark.parametrize("package", PROJECT["dependencies"])
def test_notice_states_the_licence_that_a_package_states_of_itself(package):
    about = metadata.metadata(package)
    of_itself = " ".join([about["License-Expression"] or about["License"] or "", *about.get_all("Classifier", [])])
    family = STATED[package].split("-")[0].split()[0].strip(",;")
    assert family.lower() in of_itself.lower()


def test_notice_lists_no_package_that_is_not_needed():
    assert set(STATED) - {"package"} == set(PROJECT["dependencies"])


def test_the_citation_states_the_version_and_the_licence_of_the_project():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert (citation["version"], citation["license"]) == (PROJECT["version"], PROJECT["license"])
    assert "Apache License\n" in (ROOT / "LICENSE").read_text()
