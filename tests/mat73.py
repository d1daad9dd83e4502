"""MAT-files of version 7.3 as MATLAB lays them out: HDF5 behind 512 bytes, arrays transposed, cells as references."""

from itertools import count

import h5py
import numpy as np

_HEAD = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Fri Nov 27 12:00:00 2026 HDF5 schema 1.00 ."


def write(path, data):
    """Write variables by name: numbers, texts, dicts for structs, tuples for cells."""
    with h5py.File(path, "w", userblock_size=512, libver="earliest") as file:
        names = count()

        def reference(value):
            name = f"#refs#/{next(names)}"
            put(name, value)
            return file[name].ref

        def put(name, value):
            if isinstance(value, dict):
                group = file.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key, each in value.items():
                    put(f"{name}/{key}", each)
            elif isinstance(value, tuple):
                cells = np.array([[reference(each)] for each in value], h5py.ref_dtype)
                store(name, cells, "cell")
            elif isinstance(value, str):
                store(name, np.array([[ord(each)] for each in value], np.uint16), "char", MATLAB_int_decode=np.int32(2))
            else:
                array = np.atleast_2d(np.asarray(value, float))
                store(name, array.T, "double")

        def store(name, array, kind, **more):
            shape = np.array(array.shape[::-1], np.uint64)
            each = file.create_dataset(name, data=array if array.size else shape)
            if not array.size:
                each.attrs["MATLAB_empty"] = np.uint8(1)
            each.attrs["MATLAB_class"] = np.bytes_(kind)
            for key, item in more.items():
                each.attrs[key] = item

        for name, value in data.items():
            put(name, value)
    with path.open("r+b") as stream:
        stream.write(_HEAD.ljust(116) + bytes(8) + b"\0\2IM")
    return path
