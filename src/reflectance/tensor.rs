//! Tensor files: the container of RGL `.bsdf` files (Dupuy & Jakob 2018).
//!
//! Little-endian: `tensor_file\0`, version u8 1 and u8 0, u32 field count; per field a u16 length and a name, u16
//! dimension count, u8 type, u64 offset of the data from the start of the file, one u64 per dimension. The last
//! dimension runs fastest.

use std::collections::BTreeMap;

use super::ReadError;

const MAGIC: &[u8; 12] = b"tensor_file\0";
const U8: u8 = 1;
const F32: u8 = 10;
/// Bytes per element of types 1..=11: u8 i8 u16 i16 u32 i32 u64 i64 f16 f32 f64.
const TYPE_BYTES: [usize; 11] = [1, 1, 2, 2, 4, 4, 8, 8, 2, 4, 8];
/// Bytes of a field's header with an empty name and no dimension: a bound on the number of fields of a file.
const SMALLEST_FIELD: usize = 2 + 2 + 1 + 8;
/// More dimensions than any known file has.
const MAX_DIMENSIONS: usize = 16;

/// One array of a tensor file, still as bytes.
#[derive(Debug, Clone)]
struct Tensor<'a> {
    /// Lengths of the dimensions, slowest first.
    shape: Vec<usize>,
    dtype: u8,
    offset: usize,
    bytes: &'a [u8],
}

/// The fields of a tensor file, borrowed from its bytes.
#[derive(Debug, Clone)]
pub struct TensorFile<'a> {
    file: &'a str,
    fields: BTreeMap<&'a str, Tensor<'a>>,
}

impl<'a> TensorFile<'a> {
    /// Reads the header of `bytes`; `file` is the name errors use. Nothing is copied but the headers.
    ///
    /// # Errors
    /// [`ReadError::Invalid`] where a header contradicts the format or points outside of the file, and
    /// [`ReadError::NotSupported`] for another version.
    pub fn parse(bytes: &'a [u8], file: &'a str) -> Result<Self, ReadError> {
        let mut header = Header { bytes, at: 0, file };
        if header.take(MAGIC.len())? != MAGIC {
            return Err(ReadError::invalid(file, "byte 0", "`tensor_file`", "something else"));
        }
        let [major, minor] = header.array()?;
        if (major, minor) != (1, 0) {
            return Err(ReadError::NotSupported {
                file: file.into(),
                found: format!("tensor file version {major}.{minor}"),
                remedy: "convert it to version 1.0",
            });
        }
        let count = u32::from_le_bytes(header.array()?) as usize;
        if count > bytes.len() / SMALLEST_FIELD {
            let expected = format!("at most {} fields in {} bytes", bytes.len() / SMALLEST_FIELD, bytes.len());
            return Err(ReadError::invalid(file, "byte 14 (field count)", expected, count));
        }
        let mut fields = BTreeMap::new();
        for _ in 0..count {
            let (name, tensor) = header.field()?;
            if fields.insert(name, tensor).is_some() {
                return Err(ReadError::invalid(file, format!("field `{name}`"), "it once", "it twice"));
            }
        }
        Ok(Self { file, fields })
    }

    /// Whether there is a field of this name.
    pub fn has(&self, name: &str) -> bool {
        self.fields.contains_key(name)
    }

    /// Shape and values of a field of f32 with `dimensions` dimensions.
    ///
    /// # Errors
    /// [`ReadError::Invalid`] if it is missing, of another type or shape, or holds a value that is not finite.
    pub fn f32(&self, name: &str, dimensions: usize) -> Result<(&[usize], Vec<f32>), ReadError> {
        let tensor = self.field(name, F32, "f32", dimensions)?;
        let values: Vec<f32> = tensor.bytes.as_chunks::<4>().0.iter().map(|&chunk| f32::from_le_bytes(chunk)).collect();
        match values.iter().position(|v| !v.is_finite()) {
            None => Ok((&tensor.shape, values)),
            Some(i) => {
                let at = format!("field `{name}`, byte {}", tensor.offset + 4 * i);
                Err(ReadError::invalid(self.file, at, "a finite number", values[i]))
            }
        }
    }

    /// The bytes of a one-dimensional field of u8.
    ///
    /// # Errors
    /// [`ReadError::Invalid`] if it is missing or of another type or shape.
    pub fn u8(&self, name: &str) -> Result<&'a [u8], ReadError> {
        self.field(name, U8, "u8", 1).map(|tensor| tensor.bytes)
    }

    fn field(&self, name: &str, dtype: u8, type_name: &str, dimensions: usize) -> Result<&Tensor<'a>, ReadError> {
        let expected = || format!("{type_name} in {dimensions} dimensions");
        let tensor = self
            .fields
            .get(name)
            .ok_or_else(|| ReadError::invalid(self.file, format!("field `{name}`"), expected(), "no such field"))?;
        if tensor.dtype != dtype || tensor.shape.len() != dimensions {
            let found = format!("type {} in {} dimensions", tensor.dtype, tensor.shape.len());
            return Err(ReadError::invalid(self.file, format!("field `{name}`"), expected(), found));
        }
        Ok(tensor)
    }
}

/// Collects the fields of a tensor file to be written.
#[derive(Debug, Clone, Default)]
pub struct TensorWriter {
    fields: Vec<(String, u8, Vec<usize>, Vec<u8>)>,
}

impl TensorWriter {
    /// Adds a field of f32, last dimension fastest. Panics if `values` do not fill `shape`.
    pub fn f32(&mut self, name: &str, shape: &[usize], values: &[f32]) {
        assert_eq!(shape.iter().product::<usize>(), values.len(), "field `{name}` of shape {shape:?}");
        let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.fields.push((name.into(), F32, shape.into(), bytes));
    }

    /// Adds a one-dimensional field of u8.
    pub fn u8(&mut self, name: &str, bytes: &[u8]) {
        self.fields.push((name.into(), U8, vec![bytes.len()], bytes.into()));
    }

    /// The bytes of the file, fields in the order they came.
    pub fn to_bytes(&self) -> Vec<u8> {
        let header =
            |(name, _, shape, _): &(String, u8, Vec<usize>, Vec<u8>)| SMALLEST_FIELD + name.len() + 8 * shape.len();
        let mut offset = MAGIC.len() + 2 + 4 + self.fields.iter().map(header).sum::<usize>();
        let mut file = MAGIC.to_vec();
        file.extend([1, 0]);
        file.extend((self.fields.len() as u32).to_le_bytes());
        for (name, dtype, shape, bytes) in &self.fields {
            file.extend((name.len() as u16).to_le_bytes());
            file.extend(name.as_bytes());
            file.extend((shape.len() as u16).to_le_bytes());
            file.push(*dtype);
            file.extend((offset as u64).to_le_bytes());
            shape.iter().for_each(|&n| file.extend((n as u64).to_le_bytes()));
            offset += bytes.len();
        }
        self.fields.iter().for_each(|(.., bytes)| file.extend(bytes));
        file
    }
}

/// Reads the header front to back and never past the end.
struct Header<'a> {
    bytes: &'a [u8],
    at: usize,
    file: &'a str,
}

impl<'a> Header<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], ReadError> {
        let taken = self.bytes.get(self.at..).and_then(|rest| rest.get(..count)).ok_or_else(|| {
            let (at, expected) = (format!("byte {}", self.at), format!("{count} more bytes"));
            ReadError::invalid(self.file, at, expected, format!("the end of the file at {}", self.bytes.len()))
        })?;
        self.at += count;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], ReadError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn field(&mut self) -> Result<(&'a str, Tensor<'a>), ReadError> {
        let start = self.at;
        let name_length = u16::from_le_bytes(self.array()?) as usize;
        let name = std::str::from_utf8(self.take(name_length)?)
            .map_err(|e| ReadError::invalid(self.file, format!("byte {}", start + 2), "a field name in UTF-8", e))?;
        let at = || format!("field `{name}`, header at byte {start}");

        let dimensions = u16::from_le_bytes(self.array()?) as usize;
        if dimensions > MAX_DIMENSIONS {
            return Err(ReadError::invalid(
                self.file,
                at(),
                format!("at most {MAX_DIMENSIONS} dimensions"),
                dimensions,
            ));
        }
        let [dtype] = self.array()?;
        let size = usize::from(dtype)
            .checked_sub(1)
            .and_then(|i| TYPE_BYTES.get(i))
            .ok_or_else(|| ReadError::invalid(self.file, at(), "a type from 1 to 11", dtype))?;
        let offset = u64::from_le_bytes(self.array()?);
        let lengths = (0..dimensions).map(|_| self.array().map(u64::from_le_bytes)).collect::<Result<Vec<_>, _>>()?;

        let inside = || -> Option<Tensor<'a>> {
            let shape = lengths.iter().map(|&n| usize::try_from(n).ok()).collect::<Option<Vec<_>>>()?;
            let length = shape.iter().try_fold(*size, |product, &n| product.checked_mul(n))?;
            let offset = usize::try_from(offset).ok()?;
            let bytes = self.bytes.get(offset..)?.get(..length)?;
            Some(Tensor { shape, dtype, offset, bytes })
        };
        let tensor = inside().ok_or_else(|| {
            let expected = format!("data inside of the file's {} bytes", self.bytes.len());
            ReadError::invalid(self.file, at(), expected, format!("offset {offset}, shape {lengths:?}"))
        })?;
        Ok((name, tensor))
    }
}
