"""Thin-lens formulas of lenses and sensors: focus, magnification, blur, exposure."""
