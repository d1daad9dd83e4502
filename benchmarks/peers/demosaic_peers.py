"""Demosaicing by others: colour-demosaicing, OpenCV, LibRaw through rawpy, and MLRI after its paper.

    INTERPRETER demosaic_peers.py                   answers requests, one JSON object a line, until the input ends
    INTERPRETER demosaic_peers.py IN.dng OUT.tiff   develops one file with LibRaw's AHD

A request is {"algorithm": NAME, "source": FILE without suffix, "output": FILE.npy or null}: FILE.npy holds an RGGB
mosaic (H, W), FILE.dng the same in 16 bits for LibRaw. The answer is the processor's seconds of the work alone; the
colours are written blue, green, red, in the type the algorithm gives. The algorithm "develop" makes OUT.tiff from
IN.dng.
The interpreter is one of an environment with `pip install colour-demosaicing opencv-python-headless rawpy tifffile`.
"""

import json
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

LIBRAW = "LibRaw "


def main() -> None:
    if sys.argv[1:]:
        develop(*sys.argv[1:])
        return
    for line in sys.stdin:
        print(json.dumps(answer(**json.loads(line))), flush=True)


def answer(algorithm: str, source: str, output: str | None) -> float:
    work = partial(develop, source, str(output)) if algorithm == "develop" else prepared(algorithm, source)
    begin = time.process_time()
    colour = work()
    seconds = time.process_time() - begin
    if output is not None and colour is not None:
        np.save(output, colour if algorithm.startswith("cv2") else colour[:, :, ::-1])
    return seconds


def prepared(algorithm: str, source: str) -> Callable[[], Any]:
    """Return the work, its input in memory."""
    if algorithm.startswith(LIBRAW):
        return libraw(f"{source}.dng", algorithm.removeprefix(LIBRAW))
    mosaic = np.load(f"{source}.npy")
    package, name = algorithm.split(" ")
    return partial({"cv2": opencv, "colour": colour_demosaicing, "paper": of_papers}[package], mosaic, name)


def colour_demosaicing(mosaic: np.ndarray, name: str) -> np.ndarray:
    import colour_demosaicing as package

    functions = {
        "bilinear": package.demosaicing_CFA_Bayer_bilinear,
        "Malvar2004": package.demosaicing_CFA_Bayer_Malvar2004,
        "Menon2007": package.demosaicing_CFA_Bayer_Menon2007,  # its refining step is on by default
    }
    return functions[name](mosaic, "RGGB")


def opencv(mosaic: np.ndarray, name: str) -> np.ndarray:
    import cv2

    cv2.setNumThreads(1)
    # Two letters name the pixels at row 1, columns 1 and 2: BG is RGGB.
    codes = {
        "bilinear": cv2.COLOR_BayerRGGB2BGR,
        "VNG": cv2.COLOR_BayerBG2BGR_VNG,
        "EA": cv2.COLOR_BayerBG2BGR_EA,
    }
    return cv2.demosaicing(mosaic, codes[name])


def of_papers(mosaic: np.ndarray, name: str) -> np.ndarray:
    import mlri

    return {"MLRI": mlri.mlri}[name](mosaic)


def libraw(file: str, name: str) -> Callable[[], Any]:
    """Return the work without opening and unpacking the file."""
    import rawpy

    raw = rawpy.imread(file)
    raw.raw_image_visible.max()
    return partial(raw.postprocess, **neutral(name))


def neutral(name: str) -> dict[str, Any]:
    """Return settings under which LibRaw does nothing but demosaic."""
    import rawpy

    return {
        "demosaic_algorithm": rawpy.DemosaicAlgorithm[name],
        "gamma": (1, 1),
        "no_auto_bright": True,
        "no_auto_scale": True,
        "output_color": rawpy.ColorSpace.raw,
        "user_wb": [1, 1, 1, 1],
        "output_bps": 16,
        "user_flip": 0,
    }


def develop(source: str, output: str) -> None:
    import rawpy
    import tifffile

    with rawpy.imread(source) as raw:
        tifffile.imwrite(output, raw.postprocess(**neutral("AHD")))


if __name__ == "__main__":
    main()
