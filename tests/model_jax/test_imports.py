"""What importing `model_jax` brings with it, and what it leaves alone. Fresh processes."""

import json
import subprocess
import sys

PROGRAM = """
import json, sys, jax
before = dict(jax.config.values)
import {packages}
for package in ({packages},):
    for name in dir(package):
        getattr(package, name)
after = dict(jax.config.values)
changed = [name for name in after if after[name] != before.get(name)]
print(json.dumps({{"modules": sorted(sys.modules), "changed": changed}}))
"""


def imported(packages: str) -> dict[str, list[str]]:
    program = PROGRAM.format(packages=packages)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def test_the_ground_floor_knows_nothing_above_it() -> None:
    modules = set(imported("model_jax")["modules"])
    assert "model_jax._analytic" in modules
    above = {"render_gl", "fit", "moderngl", "OpenEXR", "optimistix", "PIL", "beartype"}
    assert not modules & above


def test_importing_changes_no_configuration_of_jax() -> None:
    assert imported("model_jax, render_gl, fit")["changed"] == []
