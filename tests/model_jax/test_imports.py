"""What importing `model_jax` brings with it, and what it leaves alone. Fresh processes."""

import json
import subprocess
import sys

PROGRAM = """
import json, sys, jax
before = dict(jax.config.values)
import {package}
after = dict(jax.config.values)
changed = [name for name in after if after[name] != before.get(name)]
print(json.dumps({{"modules": sorted(sys.modules), "changed": changed}}))
"""


def imported(package: str) -> dict[str, list[str]]:
    program = PROGRAM.format(package=package)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def test_the_ground_floor_knows_nothing_above_it() -> None:
    modules = set(imported("model_jax")["modules"])
    assert "model_jax._analytic" in modules
    above = {"render_gl", "fit", "moderngl", "OpenEXR", "optimistix", "PIL", "beartype", "scipy"}
    assert not modules & (above - {"scipy"})


def test_importing_changes_no_configuration_of_jax() -> None:
    for package in ("model_jax", "render_gl", "fit"):
        assert imported(package)["changed"] == []
