"""Zarr arrays of one volume as zarr-python and numcodecs write them: tests/fixtures/zarr.json.gz.

A JSON object {case: {path of a file: its bytes}}. Every array holds the same volume (16 x
9 x 14 voxels, z slowest), whose values `value` gives; `tests/files/zarr.rs` has the same formula.

    python tools/oracle/zarr_files.py
"""

import gzip
import json
import pathlib
import tempfile
import warnings

import numcodecs
import numpy as np
import zarr
from zarr import codecs as v3

OUT = pathlib.Path(__file__).resolve().parents[2] / "tests/fixtures/zarr.json.gz"
CHUNKS = (7, 9, 9)


def value(x, y, z):
    """0 in a corner, which holds whole chunks that are not stored."""
    return np.where((z >= 7) & (x >= 9), 0, (x * x // 8 + 3 * y + z) % 61 - 20)


def volume(kind):
    z, y, x = np.meshgrid(*map(np.arange, (14, 9, 16)), indexing="ij")
    v = value(x, y, z)
    return (v + 20 if kind == "uint8" else v).astype(kind)


def files(folder):
    return {
        str(p.relative_to(folder)): list(p.read_bytes())
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def array(folder, path, data, chunks=CHUNKS, **options):
    # What equals the fill value is not stored.
    with zarr.config.set({"array.write_empty_chunks": False}):
        a = zarr.create_array(
            folder / path, shape=data.shape, chunks=chunks, dtype=data.dtype, fill_value=0, **options
        )
        a[:] = data


def version_2():
    blosc = numcodecs.Blosc
    yield "v2_zlib", "int16", {"compressors": numcodecs.Zlib(5)}
    yield "v2_zstd", "int16", {"compressors": numcodecs.Zstd(3)}
    yield "v2_lz4", "int16", {"compressors": numcodecs.LZ4()}
    yield "v2_big_endian", ">i2", {"compressors": numcodecs.Zstd(3)}
    yield "v2_columns_first", "int16", {"compressors": numcodecs.Zstd(3), "order": "F"}
    yield "v2_uint8", "uint8", {"compressors": blosc("lz4", 5, blosc.SHUFFLE)}
    shuffles = {"none": blosc.NOSHUFFLE, "bytes": blosc.SHUFFLE, "bits": blosc.BITSHUFFLE}
    for name, how in [
        *[(name, how) for name in ["lz4", "blosclz"] for how in shuffles],
        *[("zlib", "bytes"), ("zstd", "bytes"), ("zstd", "bits")],
    ]:
        # Blocks of 256 bytes: five a chunk, the last one of 55 samples.
        frames = blosc(name, 5, shuffles[how], 256)
        yield f"v2_blosc_{name}_{how}", "int16", {"compressors": frames}


def version_3():
    little = v3.BytesCodec(endian="little")
    yield "v3_raw", "int16", {"compressors": None}
    yield "v3_gzip", "int16", {"compressors": v3.GzipCodec(level=5)}
    yield "v3_zstd", "int16", {"compressors": v3.ZstdCodec(level=3)}
    yield "v3_zstd_crc", "int16", {"compressors": [v3.ZstdCodec(level=3), v3.Crc32cCodec()]}
    yield "v3_blosc", "int16", {"compressors": v3.BloscCodec(cname="lz4", clevel=5, shuffle="shuffle")}
    yield "v3_big_endian", "int16", {"serializer": v3.BytesCodec(endian="big"), "compressors": None}
    yield "v3_transposed", "int16", {"filters": v3.TransposeCodec(order=(2, 0, 1)), "compressors": None}
    for where in ["start", "end"]:
        shard = v3.ShardingCodec(
            chunk_shape=(7, 3, 9),
            codecs=[little, v3.ZstdCodec(level=3)],
            index_codecs=[little, v3.Crc32cCodec()],
            index_location=where,
        )
        yield f"v3_sharded_{where}", "int16", {"serializer": shard, "compressors": None}


def main():
    warnings.simplefilter("ignore")
    cases = {}
    with tempfile.TemporaryDirectory() as top:
        for name, kind, options in version_2():
            folder = pathlib.Path(top) / name
            keys = {"name": "v2", "separator": "/" if name == "v2_zlib" else "."}
            array(folder, "", volume(kind), zarr_format=2, chunk_key_encoding=keys, **options)
            cases[name] = files(folder)
        for name, kind, options in version_3():
            folder = pathlib.Path(top) / name
            array(folder, "", volume(kind), zarr_format=3, **options)
            cases[name] = files(folder)
    text = json.dumps(cases, separators=(",", ":"))
    OUT.write_bytes(gzip.compress(text.encode(), 9, mtime=0))
    print(f"{OUT}: {len(cases)} arrays, {OUT.stat().st_size} bytes")


if __name__ == "__main__":
    main()
