//! The VTK XML file of polygonal data (.vtp), arrays appended as raw bytes.

use std::io::{self, Write};

/// Numbers of one array in native byte order.
pub(in crate::formats) struct DataArray<'a> {
    name: &'a str,
    kind: &'static str,
    components: usize,
    bytes: &'a [u8],
}

/// A number type that VTK knows.
pub(in crate::formats) trait Number: bytemuck::Pod {
    const NAME: &'static str;
}
impl Number for f32 {
    const NAME: &'static str = "Float32";
}
impl Number for f64 {
    const NAME: &'static str = "Float64";
}
impl Number for i32 {
    const NAME: &'static str = "Int32";
}
impl Number for u8 {
    const NAME: &'static str = "UInt8";
}

impl<'a> DataArray<'a> {
    pub fn new<T: Number>(name: &'a str, components: usize, values: &'a [T]) -> Self {
        Self { name, kind: T::NAME, components, bytes: bytemuck::cast_slice(values) }
    }
}

/// Points and either lines or polygons.
pub(in crate::formats) struct PolyData<'a> {
    /// `FACING` of the field data; left out where empty.
    pub facing: &'a str,
    pub points: DataArray<'a>,
    pub point_count: usize,
    pub point_data: Vec<DataArray<'a>>,
    /// Attribute of the point data element, such as `Normals="Normals"`.
    pub active: &'static str,
    /// `Lines` or `Polys`.
    pub cells: &'static str,
    pub cell_count: usize,
    pub connectivity: DataArray<'a>,
    pub offsets: DataArray<'a>,
    pub cell_data: Vec<DataArray<'a>>,
}

impl PolyData<'_> {
    /// Writes the file, with `SPACE` = `LPS` in its field data.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let order = if cfg!(target_endian = "little") { "LittleEndian" } else { "BigEndian" };
        let (points, cells, active) = (self.point_count, self.cell_count, self.active);
        let count = |kind| if kind == self.cells { cells } else { 0 };
        let (lines, polys) = (count("Lines"), count("Polys"));
        let mut appended = Appended::default();
        writeln!(out, "<?xml version=\"1.0\"?>")?;
        writeln!(
            out,
            "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"{order}\" header_type=\"UInt64\">"
        )?;
        writeln!(out, "<PolyData>\n<FieldData>")?;
        // A string array is its character codes, each string closed by a zero.
        let text = "type=\"String\" NumberOfTuples=\"1\" format=\"ascii\"";
        for (name, value) in [("SPACE", "LPS"), ("FACING", self.facing)] {
            if !value.is_empty() {
                let codes: String = value.bytes().map(|c| format!("{c} ")).collect();
                writeln!(out, "<Array Name=\"{name}\" {text}>{codes}0</Array>")?;
            }
        }
        writeln!(out, "</FieldData>")?;
        writeln!(
            out,
            "<Piece NumberOfPoints=\"{points}\" NumberOfVerts=\"0\" NumberOfLines=\"{lines}\" \
             NumberOfStrips=\"0\" NumberOfPolys=\"{polys}\">"
        )?;
        appended.section(out, "PointData", active, self.point_data.iter())?;
        appended.section(out, "CellData", "", self.cell_data.iter())?;
        appended.section(out, "Points", "", [&self.points].into_iter())?;
        appended.section(out, self.cells, "", [&self.connectivity, &self.offsets].into_iter())?;
        writeln!(out, "</Piece>\n</PolyData>\n<AppendedData encoding=\"raw\">")?;
        out.write_all(b"_")?;
        for bytes in appended.blocks {
            out.write_all(&(bytes.len() as u64).to_ne_bytes())?;
            out.write_all(bytes)?;
        }
        writeln!(out, "\n</AppendedData>\n</VTKFile>")
    }
}

/// The blocks that follow the XML, in the order they were named in.
#[derive(Default)]
struct Appended<'a> {
    blocks: Vec<&'a [u8]>,
    offset: usize,
}

impl<'a> Appended<'a> {
    fn section(
        &mut self,
        out: &mut dyn Write,
        tag: &str,
        attributes: &str,
        arrays: impl Iterator<Item = &'a DataArray<'a>>,
    ) -> io::Result<()> {
        let gap = if attributes.is_empty() { "" } else { " " };
        writeln!(out, "<{tag}{gap}{attributes}>")?;
        for DataArray { name, kind, components, bytes } in arrays {
            writeln!(
                out,
                "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" \
                 format=\"appended\" offset=\"{}\"/>",
                self.offset
            )?;
            self.offset += size_of::<u64>() + bytes.len();
            self.blocks.push(bytes);
        }
        writeln!(out, "</{tag}>")
    }
}
