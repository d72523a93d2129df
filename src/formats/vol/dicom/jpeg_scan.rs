//! Whether a JPEG stream holds every sample of its frame.
//!
//! Decoders fill a scan that ends too soon with zero bits and report nothing, so the codes of the
//! scan are counted here first. Only their lengths are looked at, no sample is made and no memory
//! taken, whatever size the stream claims (ITU-T T.81, annexes F.2.2 and H.2).

/// Coding process of a scan's samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Process {
    /// Blocks of 8x8 coefficients one after the other.
    Sequential,
    /// One difference a sample.
    Lossless,
}

/// Length of each code and its value, by the sixteen bits that begin with it; length 0 is no code.
type Table = Vec<(u8, u8)>;

/// Refuses a stream of one component that ends before its last sample.
///
/// # Errors
/// The unit of samples at which it ends, or the damaged part.
pub(super) fn check_complete(
    bytes: &[u8],
    process: Process,
    [columns, rows]: [u32; 2],
) -> Result<(), String> {
    let units = match process {
        Process::Sequential => u64::from(columns.div_ceil(8)) * u64::from(rows.div_ceil(8)),
        Process::Lossless => u64::from(columns) * u64::from(rows),
    };
    let mut tables: [[Table; 4]; 2] = Default::default();
    let (mut at, mut interval, mut scans) = (2, 0u64, 0);
    while let Some(marker) = next_marker(bytes, &mut at) {
        // Markers without a body.
        if matches!(marker, 0x01 | 0xd0..=0xd8) {
            continue;
        }
        if marker == 0xd9 {
            break;
        }
        let body = body(bytes, &mut at).ok_or("a marker's body is cut off")?;
        match marker {
            0xc4 => read_tables(body, &mut tables).ok_or("a damaged code table")?,
            0xdd => interval = u64::from(u16_at(body, 0).ok_or("a damaged restart interval")?),
            0xda => {
                let choice =
                    *body.get(2).filter(|_| body[0] == 1).ok_or("a damaged scan header")?;
                let [dc, ac] =
                    [&tables[0][usize::from(choice >> 4) & 3], &tables[1][usize::from(choice) & 3]];
                at = scan(bytes, at, process, [dc, ac], units, interval)?;
                scans += 1;
            }
            _ => {}
        }
    }
    if scans == 0 { Err("no scan".into()) } else { Ok(()) }
}

/// Passes the codes of a scan; the place behind its last one.
fn scan(
    bytes: &[u8],
    at: usize,
    process: Process,
    [dc, ac]: [&Table; 2],
    units: u64,
    interval: u64,
) -> Result<usize, String> {
    let mut bits = Bits { bytes, at, buffer: 0, held: 0 };
    for unit in 0..units {
        if interval > 0 && unit > 0 && unit % interval == 0 {
            let wanted = 0xd0 + ((unit / interval - 1) % 8) as u8;
            let mut at = bits.at;
            if next_marker(bytes, &mut at) != Some(wanted) {
                return Err(format!("no restart marker after {unit} of {units} units"));
            }
            bits = Bits { bytes, at, buffer: 0, held: 0 };
        }
        let passed = match process {
            Process::Lossless => bits.pass_difference(dc),
            Process::Sequential => bits.pass_block(dc, ac),
        };
        passed.ok_or_else(|| format!("its scan ends after {unit} of {units} units"))?;
    }
    Ok(bits.at)
}

/// The next marker at or behind a place, which moves past it.
fn next_marker(bytes: &[u8], at: &mut usize) -> Option<u8> {
    loop {
        let [first, second] = *bytes.get(*at..*at + 2)? else { return None };
        if first == 0xff && !matches!(second, 0 | 0xff) {
            *at += 2;
            return Some(second);
        }
        *at += 1;
    }
}

/// A marker's body behind its length; the place moves past it.
fn body<'a>(bytes: &'a [u8], at: &mut usize) -> Option<&'a [u8]> {
    let len = usize::from(u16_at(bytes, *at)?);
    let body = bytes.get(*at + 2..*at + len)?;
    *at += len;
    Some(body).filter(|b| !b.is_empty())
}

fn u16_at(bytes: &[u8], at: usize) -> Option<u16> {
    let two = bytes.get(at..at + 2)?;
    Some(u16::from_be_bytes([two[0], two[1]]))
}

/// The code tables of a marker (annex C: codes of a length follow each other, then gain a bit).
fn read_tables(mut body: &[u8], tables: &mut [[Table; 4]; 2]) -> Option<()> {
    while let Some((&which, rest)) = body.split_first() {
        let (counts, mut rest) = rest.split_at_checked(16)?;
        let table = tables.get_mut(usize::from(which >> 4))?.get_mut(usize::from(which & 15))?;
        table.clear();
        for (length, count) in (1u8..).zip(counts) {
            let (values, behind) = rest.split_at_checked(usize::from(*count))?;
            rest = behind;
            let codes = usize::from(*count) << (16 - length);
            if table.len() + codes > 1 << 16 {
                return None;
            }
            for value in values {
                table.resize(table.len() + (1 << (16 - length)), (length, *value));
            }
        }
        table.resize(1 << 16, (0, 0));
        body = rest;
    }
    Some(())
}

/// The bits between two markers, the highest of a byte first.
struct Bits<'a> {
    bytes: &'a [u8],
    /// Byte that is read next; stays at the marker that ends them.
    at: usize,
    buffer: u64,
    held: u32,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.held <= 56 {
            let Some(&byte) = self.bytes.get(self.at) else { return };
            if byte == 0xff {
                // A zero is stuffed behind a byte of ones; anything else is a marker.
                if self.bytes.get(self.at + 1) != Some(&0) {
                    return;
                }
                self.at += 1;
            }
            self.at += 1;
            self.buffer |= u64::from(byte) << (56 - self.held);
            self.held += 8;
        }
    }

    fn pass(&mut self, count: u32) -> Option<()> {
        if self.held < count {
            self.fill();
        }
        self.held = self.held.checked_sub(count)?;
        self.buffer <<= count;
        Some(())
    }

    /// The value of the next code.
    fn code(&mut self, table: &Table) -> Option<u8> {
        if self.held < 16 {
            self.fill();
        }
        let (length, value) = *table.get((self.buffer >> 48) as usize)?;
        if length == 0 {
            return None;
        }
        self.pass(u32::from(length))?;
        Some(value)
    }

    /// A difference: its number of bits, then those; of sixteen there are none (H.1.2.2).
    fn pass_difference(&mut self, table: &Table) -> Option<()> {
        match self.code(table)? {
            16 => Some(()),
            count => self.pass(u32::from(count).min(16)),
        }
    }

    /// A block: its difference, then runs of zeros with a coefficient behind each (F.2.2.2).
    fn pass_block(&mut self, dc: &Table, ac: &Table) -> Option<()> {
        self.pass_difference(dc)?;
        let mut k = 1;
        while k < 64 {
            let code = self.code(ac)?;
            match (code >> 4, code & 15) {
                (15, 0) => k += 16,
                (_, 0) => break,
                (zeros, count) => {
                    k += u32::from(zeros) + 1;
                    self.pass(u32::from(count))?;
                }
            }
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_of_more_codes_than_there_are_takes_no_memory() {
        let mut tables: [[Table; 4]; 2] = Default::default();
        let body: Vec<u8> = [0].into_iter().chain([255; 16]).chain(vec![7; 16 * 255]).collect();
        assert_eq!(read_tables(&body, &mut tables), None);
        assert!(tables[0][0].capacity() <= 1 << 17, "{}", tables[0][0].capacity());
    }
}
