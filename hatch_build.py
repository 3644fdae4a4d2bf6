"""Builds the wheel: the viewer's modules go into it as the one script that pages are made of."""

import runpy
import tempfile
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ViewerScript(BuildHookInterface):
    """Puts ``pgm/viewer/script.js`` into a wheel, in place of the modules that it joins."""

    def initialize(self, version, build_data):
        """Write the script beside the wheel's other files; a checkout keeps its modules."""
        if version == "editable":
            return
        module = runpy.run_path(str(Path(self.root) / "pgm" / "viewer" / "scripts.py"))
        self.folder = tempfile.TemporaryDirectory()
        script = Path(self.folder.name) / "script.js"
        script.write_text(module["joined"](), encoding="utf-8")
        build_data["force_include"][str(script)] = "pgm/viewer/script.js"

    def finalize(self, version, build_data, artifact_path):
        """Remove what was written for the build."""
        if version != "editable":
            self.folder.cleanup()
