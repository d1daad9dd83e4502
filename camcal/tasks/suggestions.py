"""Names for helps and for the completions of a shell: only what asks for them imports what they are names of."""


def board_kinds() -> list[str]:
    """Return the beginnings of the short forms of boards."""
    from camcal.targets.board_types import FORMS

    return [f"{kind}:" for kind in FORMS]


def camera_formats() -> str:
    """Return the help of --to, which names the camera formats."""
    return f"Format of OUT where its name does not say it: {', '.join(format_names())}."


def format_names() -> list[str]:
    """Return the names of the camera formats that are written."""
    from camcal.formats.cameras import FORMATS

    return [form.name for form in FORMATS.values() if form.suffixes]


def lens_models() -> str:
    """Return the names of the lens models."""
    from camcal.cameras.catalogue import help_line

    return help_line()


def lens_model_names() -> list[str]:
    """Return the names of the lens models that cameras are calibrated with."""
    from camcal.cameras.catalogue import MODELS

    return [name for name, model in MODELS.items() if not model.is_view]
