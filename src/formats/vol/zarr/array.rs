//! Metadata of a Zarr array, versions 2 and 3: shape, type, chunks and codecs.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::codec::ByteCodec;
use crate::formats::FormatError;
use crate::formats::vol::layout::must_swap;
use crate::formats::vol::source::prefix;
use crate::volume::SampleType;

/// Longest metadata that are read, bytes: parsed they take some thirty times as much.
const MAX_METADATA: u64 = 1 << 18;
/// Most axes of an array: OME-NGFF has five.
const MAX_AXES: usize = 8;
/// Most bytes of a chunk once decoded: it comes whole.
const MAX_CHUNK: u64 = 1 << 28;
/// Most files of an array: each is asked for.
const MAX_CHUNKS: u64 = 1 << 22;

/// An array on disk: what its metadata promise.
#[derive(Debug)]
pub(super) struct ZarrArray {
    pub dir: PathBuf,
    pub shape: Vec<u64>,
    pub sample_type: SampleType,
    /// Value of what no chunk holds, as the bytes of a sample of this machine.
    pub fill: Vec<u8>,
    /// Shape of what a file holds: a chunk or a shard.
    pub file_shape: Vec<u64>,
    pub keys: Keys,
    pub chunk: Chunk,
    /// Index of a shard; `None` where a file is one chunk.
    pub shard: Option<Shard>,
}

/// Names of the files of an array.
#[derive(Clone, Debug)]
pub(super) struct Keys {
    /// Before the numbers; may be empty.
    pub prefix: &'static str,
    pub separator: char,
}

/// Storage of a chunk's samples.
#[derive(Clone, Debug)]
pub(super) struct Chunk {
    pub shape: Vec<u64>,
    /// Array axis of each stored axis, slowest first.
    pub order: Vec<usize>,
    /// Whether the byte order is not this machine's.
    pub swap: bool,
    pub codecs: Vec<ByteCodec>,
}

/// Index of a shard.
#[derive(Clone, Debug)]
pub(super) struct Shard {
    pub is_index_last: bool,
    pub codecs: Vec<ByteCodec>,
}

/// The JSON of a file of metadata; `None` where it is not there.
pub(super) fn metadata(dir: &Path, name: &str) -> Result<Option<Value>, FormatError> {
    let path = dir.join(name);
    if !path.exists() {
        return Ok(None);
    }
    let bytes = prefix(&path, MAX_METADATA + 1)?;
    if bytes.len() as u64 > MAX_METADATA {
        let why = format!("more than {MAX_METADATA} bytes of metadata");
        return Err(FormatError::text(&path, "size", why));
    }
    let value = serde_json::from_slice(&bytes);
    value.map(Some).map_err(|_| FormatError::text(&path, "metadata", "not JSON"))
}

/// Metadata with the file they are of, for errors.
pub(super) struct Meta<'a> {
    pub file: &'a Path,
    pub value: &'a Value,
}

impl<'a> Meta<'a> {
    pub fn bad(&self, field: &str, why: impl Into<String>) -> FormatError {
        FormatError::text(self.file, field, why)
    }

    pub fn unsupported(&self, what: impl Into<String>) -> FormatError {
        FormatError::unsupported(self.file, what)
    }

    /// Sizes along the axes, each one or more.
    fn sizes(&self, field: &str, value: Option<&Value>) -> Result<Vec<u64>, FormatError> {
        let list = value.and_then(Value::as_array).filter(|l| (1..=MAX_AXES).contains(&l.len()));
        let sizes = list.and_then(|l| l.iter().map(Value::as_u64).collect::<Option<Vec<_>>>());
        let sizes = sizes.filter(|sizes| sizes.iter().all(|s| *s > 0));
        sizes.ok_or_else(|| self.bad(field, format!("expected 1 to {MAX_AXES} sizes")))
    }
}

impl ZarrArray {
    /// Reads the metadata of the array in a folder; `None` where there is none.
    pub fn open(dir: &Path) -> Result<Option<Self>, FormatError> {
        let array = if let Some(value) = metadata(dir, "zarr.json")? {
            if value["node_type"] != "array" {
                return Ok(None);
            }
            let file = dir.join("zarr.json");
            Self::version_3(dir, &Meta { file: &file, value: &value })?
        } else if let Some(value) = metadata(dir, ".zarray")? {
            let file = dir.join(".zarray");
            Self::version_2(dir, &Meta { file: &file, value: &value })?
        } else {
            return Ok(None);
        };
        array.check(dir)?;
        Ok(Some(array))
    }

    /// Holds sizes against each other and against what is read.
    fn check(&self, dir: &Path) -> Result<(), FormatError> {
        let axes = self.shape.len();
        if self.file_shape.len() != axes || self.chunk.shape.len() != axes {
            return Err(FormatError::text(dir, "chunk shape", "not of the array's axes"));
        }
        let size = self.sample_type.size() as u64;
        let bytes = self.chunk.shape.iter().try_fold(size, |n, s| n.checked_mul(*s));
        if bytes.is_none_or(|n| n > MAX_CHUNK) {
            let what = format!("a chunk of more than {MAX_CHUNK} bytes, which is read whole");
            return Err(FormatError::unsupported(dir, what));
        }
        let fits = self.file_shape.iter().zip(&self.chunk.shape).all(|(f, c)| f % c == 0);
        let inner = self.file_shape.iter().zip(&self.chunk.shape).map(|(f, c)| f / c);
        let inner = inner.fold(1u64, u64::saturating_mul);
        if !fits || inner > 1 << 20 {
            let why = "no multiple of the chunks within, or more than a million of them";
            return Err(FormatError::text(dir, "shard shape", why));
        }
        let files = self.shape.iter().zip(&self.file_shape).map(|(s, c)| s.div_ceil(*c));
        if files.fold(1u64, u64::saturating_mul) > MAX_CHUNKS {
            return Err(FormatError::unsupported(dir, format!("more than {MAX_CHUNKS} chunks")));
        }
        Ok(())
    }

    fn version_2(dir: &Path, meta: &Meta) -> Result<Self, FormatError> {
        let v = meta.value;
        if v["zarr_format"] != 2 {
            return Err(meta.bad("zarr_format", "not 2"));
        }
        if v["filters"].as_array().is_some_and(|f| !f.is_empty()) {
            return Err(meta.unsupported("filters of Zarr 2"));
        }
        let shape = meta.sizes("shape", v.get("shape"))?;
        let file_shape = meta.sizes("chunks", v.get("chunks"))?;
        let (sample_type, swap) = dtype(meta)?;
        let codecs = match &v["compressor"] {
            Value::Null => Vec::new(),
            compressor => vec![codec(meta, compressor["id"].as_str())?],
        };
        let axes = 0..shape.len();
        let order = match v["order"].as_str() {
            Some("C") | None => axes.collect(),
            Some("F") => axes.rev().collect(),
            Some(_) => return Err(meta.bad("order", "neither C nor F")),
        };
        let separator = match v["dimension_separator"].as_str() {
            Some("/") => '/',
            Some(".") | None => '.',
            Some(_) => return Err(meta.bad("dimension_separator", "neither `/` nor `.`")),
        };
        let fill = fill(meta, sample_type)?;
        let chunk = Chunk { shape: file_shape.clone(), order, swap, codecs };
        let (dir, keys) = (dir.to_owned(), Keys { prefix: "", separator });
        Ok(Self { dir, shape, sample_type, fill, file_shape, keys, chunk, shard: None })
    }

    fn version_3(dir: &Path, meta: &Meta) -> Result<Self, FormatError> {
        let v = meta.value;
        if v["zarr_format"] != 3 {
            return Err(meta.bad("zarr_format", "not 3"));
        }
        if v["storage_transformers"].as_array().is_some_and(|t| !t.is_empty()) {
            return Err(meta.unsupported("storage transformers"));
        }
        let shape = meta.sizes("shape", v.get("shape"))?;
        let sample_type = v["data_type"].as_str().and_then(type_named);
        let sample_type =
            sample_type.ok_or_else(|| meta.unsupported("this data_type; give numbers"))?;
        if v["chunk_grid"]["name"] != "regular" {
            return Err(meta.unsupported("a chunk_grid that is not regular"));
        }
        let grid = &v["chunk_grid"]["configuration"];
        let file_shape = meta.sizes("chunk_shape", grid.get("chunk_shape"))?;
        let (chunk, shard) = codecs(meta, &v["codecs"], &file_shape)?;
        let fill = fill(meta, sample_type)?;
        let (dir, keys) = (dir.to_owned(), keys(meta)?);
        Ok(Self { dir, shape, sample_type, fill, file_shape, keys, chunk, shard })
    }
}

fn keys(meta: &Meta) -> Result<Keys, FormatError> {
    let v = &meta.value["chunk_key_encoding"];
    let (prefix, own) = match v["name"].as_str() {
        Some("default") => ("c", '/'),
        Some("v2") => ("", '.'),
        _ => return Err(meta.unsupported("this chunk_key_encoding")),
    };
    let separator = match v["configuration"]["separator"].as_str() {
        None => own,
        Some("/") => '/',
        Some(".") => '.',
        Some(_) => return Err(meta.bad("separator", "neither `/` nor `.`")),
    };
    Ok(Keys { prefix, separator })
}

/// Codecs of a chunk, or of a shard and its chunks.
fn codecs(meta: &Meta, list: &Value, shape: &[u64]) -> Result<(Chunk, Option<Shard>), FormatError> {
    let list = list.as_array().filter(|l| l.len() <= MAX_AXES);
    let list = list.ok_or_else(|| meta.bad("codecs", "expected a short list"))?;
    let mut chunk = Chunk {
        shape: shape.to_vec(),
        order: (0..shape.len()).collect(),
        swap: false,
        codecs: vec![],
    };
    let mut shard = None;
    let mut is_packed = false;
    for item in list {
        let (name, options) = (item["name"].as_str(), &item["configuration"]);
        match (name, is_packed) {
            (Some("transpose"), false) => chunk.order = transposed(meta, options, &chunk.order)?,
            (Some("bytes"), false) => {
                chunk.swap = match options["endian"].as_str() {
                    Some("big") => must_swap(true),
                    Some("little") | None => must_swap(false),
                    Some(_) => return Err(meta.bad("endian", "neither little nor big")),
                };
                is_packed = true;
            }
            (Some("sharding_indexed"), false) => {
                if !chunk.order.is_sorted() {
                    return Err(meta.unsupported("a transposed shard"));
                }
                let inner = meta.sizes("chunk_shape", options.get("chunk_shape"))?;
                let (inside, nested) = codecs(meta, &options["codecs"], &inner)?;
                let (index, _) = codecs(meta, &options["index_codecs"], &[1])?;
                if nested.is_some() || index.swap != must_swap(false) {
                    return Err(meta.unsupported("shards in shards, or an index of big numbers"));
                }
                let is_index_last = options["index_location"] != "start";
                shard = Some(Shard { is_index_last, codecs: index.codecs });
                chunk = inside;
                is_packed = true;
            }
            (_, true) if shard.is_some() => {
                return Err(meta.unsupported("a shard that is compressed as a whole"));
            }
            (name, true) => chunk.codecs.push(codec(meta, name)?),
            (_, false) => return Err(meta.unsupported("this codec of an array")),
        }
    }
    if is_packed { Ok((chunk, shard)) } else { Err(meta.bad("codecs", "no codec makes bytes")) }
}

/// The order of axes after a transposition of those that are stored in `order`.
fn transposed(meta: &Meta, options: &Value, order: &[usize]) -> Result<Vec<usize>, FormatError> {
    let list = options["order"].as_array().map(Vec::as_slice).unwrap_or_default();
    let by = list.iter().map(|n| n.as_u64().and_then(|n| usize::try_from(n).ok()));
    let by: Option<Vec<usize>> = by.collect();
    let by = by.filter(|by| {
        let mut sorted = by.clone();
        sorted.sort_unstable();
        sorted.iter().copied().eq(0..order.len())
    });
    let by = by.ok_or_else(|| meta.bad("order of transpose", "not a permutation of the axes"))?;
    Ok(by.into_iter().map(|k| order[k]).collect())
}

fn codec(meta: &Meta, name: Option<&str>) -> Result<ByteCodec, FormatError> {
    Ok(match name {
        Some("gzip") => ByteCodec::Gzip,
        Some("zlib" | "numcodecs.zlib") => ByteCodec::Zlib,
        Some("zstd" | "numcodecs.zstd") => ByteCodec::Zstd,
        Some("blosc" | "numcodecs.blosc") => ByteCodec::Blosc,
        Some("lz4" | "numcodecs.lz4") => ByteCodec::Lz4,
        Some("crc32c") => ByteCodec::Crc32c,
        _ => {
            let what = "this codec; known are gzip, zlib, zstd, blosc, lz4, crc32c, transpose and \
                        sharding_indexed";
            return Err(meta.unsupported(what));
        }
    })
}

fn type_named(name: &str) -> Option<SampleType> {
    use SampleType as S;
    [S::U8, S::I8, S::U16, S::I16, S::U32, S::I32, S::U64, S::I64, S::F32, S::F64]
        .into_iter()
        .find(|t| t.name() == name)
}

/// Type and byte order of version 2: `<i2`, `|u1`, `>f4`.
fn dtype(meta: &Meta) -> Result<(SampleType, bool), FormatError> {
    use SampleType as S;
    let name = meta.value["dtype"].as_str().unwrap_or_default();
    let (order, kind) = name.split_at_checked(1).unwrap_or_default();
    let sample_type = match kind {
        "u1" => S::U8,
        "i1" => S::I8,
        "u2" => S::U16,
        "i2" => S::I16,
        "u4" => S::U32,
        "i4" => S::I32,
        "u8" => S::U64,
        "i8" => S::I64,
        "f4" => S::F32,
        "f8" => S::F64,
        _ => return Err(meta.unsupported("this dtype; give numbers")),
    };
    match order {
        "<" | "|" => Ok((sample_type, sample_type.size() > 1 && must_swap(false))),
        ">" => Ok((sample_type, sample_type.size() > 1 && must_swap(true))),
        _ => Err(meta.bad("dtype", "begins with neither <, > nor |")),
    }
}

/// The fill value as bytes of this machine; null is 0.
fn fill(meta: &Meta, sample_type: SampleType) -> Result<Vec<u8>, FormatError> {
    use SampleType as S;
    let value = &meta.value["fill_value"];
    let real = match value {
        Value::Null => Some(0.0),
        Value::String(name) => match name.as_str() {
            "NaN" => Some(f64::NAN),
            "Infinity" => Some(f64::INFINITY),
            "-Infinity" => Some(f64::NEG_INFINITY),
            _ => None,
        },
        number => number.as_f64(),
    };
    let bad = || meta.bad("fill_value", "not a number of the array's type");
    let whole = value.as_i64().or_else(|| real.filter(|r| r.fract() == 0.0).map(|r| r as i64));
    macro_rules! int {
        ($t:ty) => {
            <$t>::try_from(whole.ok_or_else(bad)?).map_err(|_| bad())?.to_ne_bytes().to_vec()
        };
    }
    Ok(match sample_type {
        S::U8 => int!(u8),
        S::I8 => int!(i8),
        S::U16 => int!(u16),
        S::I16 => int!(i16),
        S::U32 => int!(u32),
        S::I32 => int!(i32),
        S::I64 => int!(i64),
        S::U64 if value.is_null() => vec![0; 8],
        S::U64 => value.as_u64().ok_or_else(bad)?.to_ne_bytes().to_vec(),
        S::F32 => (real.ok_or_else(bad)? as f32).to_ne_bytes().to_vec(),
        S::F64 => real.ok_or_else(bad)?.to_ne_bytes().to_vec(),
    })
}
