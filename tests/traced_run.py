"""Run a command of camcal and print, as JSON, through how many of its modules and functions it passes, and how many
types of records it makes: python tests/traced_run.py calibrate detections.csv -o camera.yaml
"""

import json
import sys
from pathlib import Path
from types import FrameType

import camcal
from camcal.cli.main import main

ROOT = f"{Path(camcal.__file__).parent}/"
INNER = ("<module>", "<genexpr>", "<listcomp>", "<dictcomp>", "<setcomp>", "<lambda>")

functions: set[tuple[str, str]] = set()
records: set[type] = set()


def note(frame: FrameType, event: str, _: object) -> None:
    code = frame.f_code
    if event != "call":
        return
    if code.co_filename.startswith(ROOT) and not code.co_qualname.endswith(INNER):
        functions.add((code.co_filename, code.co_qualname))
    elif code.co_filename.endswith(".__init__>"):  # of a data class
        made = type(frame.f_locals.get("self"))
        if made.__module__.startswith("camcal"):
            records.add(made)


if __name__ == "__main__":
    sys.setprofile(note)
    try:
        main()
    except SystemExit as ended:
        code = ended.code
    finally:
        sys.setprofile(None)
    counts = {"modules": len({file for file, _ in functions}), "functions": len(functions), "records": len(records)}
    sys.stderr.write(json.dumps(counts))
    sys.exit(code)
