//! Whether the compressed data of a JPEG are whole (ITU-T T.81). Decoders put grey in the place of what is missing, and do not say so.

use std::ops::ControlFlow;

/// Bytes behind the last block of a scan, or before a restart, that are not said: encoders may fill up what they write.
const MOST_LEFT: usize = 16;

/// Why the data of a JPEG are not those of all of its blocks. `None` if they are, and for JPEGs that are progressive, arithmetic
/// or otherwise rare, which are not looked at.
pub(super) fn damage(bytes: &[u8]) -> Option<String> {
    if !bytes.starts_with(&[0xff, 0xd8]) {
        return None;
    }
    let (mut reading, mut at) = (Reading::default(), 2);
    loop {
        at += bytes.get(at..)?.windows(2).position(|pair| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff))?;
        let marker = bytes[at + 1];
        if matches!(marker, 0x01 | 0xd0..=0xd8) {
            at += 2;
            continue;
        }
        let length = usize::from(u16::from_be_bytes([*bytes.get(at + 2)?, *bytes.get(at + 3)?]));
        let (segment, behind) = (bytes.get(at + 4..at + 2 + length), at + 2 + length);
        match (marker, segment) {
            (0xd9, _) => return reading.missing(),
            (0xda, Some(header)) => match reading.scan(header, bytes, behind)? {
                Ok(end) => at = end,
                Err(damage) => return Some(damage),
            },
            (_, Some(segment)) => {
                if reading.segment(marker, segment)?.is_break() {
                    return None;
                }
                at = behind;
            }
            (_, None) => return None,
        }
    }
}

/// Size, components and tables, which segments before a scan give.
#[derive(Default)]
struct Reading {
    width: usize,
    height: usize,
    components: Vec<Component>,
    /// By class, DC and AC, and number.
    tables: [[Option<Table>; 4]; 2],
    restart_interval: usize,
    /// Components of all scans so far.
    seen: usize,
}

struct Component {
    id: u8,
    horizontal: usize,
    vertical: usize,
}

/// A Huffman table, by lengths of its codes.
#[derive(Clone)]
struct Table {
    /// The first number of 16 bits that begins with a longer code.
    limits: [u32; 17],
    /// A code minus this is the index of its symbol.
    offsets: [i32; 17],
    symbols: Vec<u8>,
}

impl Table {
    /// From the numbers of codes of 1 to 16 bits, and their symbols in order.
    fn new(counts: &[u8], symbols: &[u8]) -> Self {
        let (mut limits, mut offsets, mut code, mut index) = ([0; 17], [0; 17], 0u32, 0i32);
        for (bits, &count) in (1..).zip(counts) {
            offsets[bits] = code as i32 - index;
            code += u32::from(count);
            index += i32::from(count);
            limits[bits] = code << (16 - bits);
            code <<= 1;
        }
        Self { limits, offsets, symbols: symbols.to_vec() }
    }
}

/// Bits of the data of a scan up to the next marker.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    buffer: u64,
    count: u32,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.count <= 48 {
            let (byte, length) = match (self.bytes.get(self.at), self.bytes.get(self.at + 1)) {
                (Some(0xff), Some(0)) => (0xff, 2),
                (Some(0xff), _) | (None, _) => return,
                (Some(&byte), _) => (byte, 1),
            };
            self.at += length;
            self.buffer = self.buffer << 8 | u64::from(byte);
            self.count += 8;
        }
    }

    /// The next symbol by `table`.
    fn symbol(&mut self, table: &Table) -> Result<u8, Wrong> {
        if self.count < 16 {
            self.fill();
        }
        let next = if self.count >= 16 { self.buffer >> (self.count - 16) } else { self.buffer << (16 - self.count) };
        let next = next as u32 & 0xffff;
        let bits = (1..=16).find(|&bits| next < table.limits[bits]).ok_or(Wrong::Code)?;
        let index = (next >> (16 - bits)) as i32 - table.offsets[bits];
        self.skip(bits as u32)?;
        table.symbols.get(index as usize).copied().ok_or(Wrong::Code)
    }

    fn skip(&mut self, bits: u32) -> Result<(), Wrong> {
        if self.count < bits {
            self.fill();
        }
        self.count = self.count.checked_sub(bits).ok_or(Wrong::End)?;
        Ok(())
    }

    /// Passes over the differences of a block.
    fn block(&mut self, dc: &Table, ac: &Table) -> Result<(), Wrong> {
        let bits = self.symbol(dc)?;
        self.skip(u32::from(bits))?;
        let mut coefficient = 1;
        while coefficient < 64 {
            let symbol = self.symbol(ac)?;
            let (run, bits) = (usize::from(symbol >> 4), u32::from(symbol & 15));
            match (run, bits) {
                (15, 0) => coefficient += 16,
                (_, 0) => break,
                _ => {
                    coefficient += run + 1;
                    self.skip(bits)?;
                }
            }
        }
        if coefficient > 64 { Err(Wrong::Code) } else { Ok(()) }
    }

    /// The bytes up to the next marker that are not in the buffer.
    fn rest(&self) -> &[u8] {
        let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0 | 0xff);
        let rest = self.bytes.get(self.at..).unwrap_or_default();
        &rest[..rest.windows(2).position(is_marker).unwrap_or(rest.len())]
    }

    /// The number of bytes before the next marker that no block has used, without those that fill up.
    fn left(&self) -> usize {
        let data = self.rest().iter().rposition(|byte| !matches!(byte, 0 | 0xff)).map_or(0, |last| last + 1);
        self.count as usize / 8 + data
    }
}

/// Faults of the data of a block.
enum Wrong {
    /// There are none.
    End,
    /// They are none that an encoder writes.
    Code,
}

impl Reading {
    /// Reads a segment before a scan; breaks off for a JPEG that is not looked at. `None` if the segment is not whole.
    fn segment(&mut self, marker: u8, segment: &[u8]) -> Option<ControlFlow<()>> {
        match marker {
            // baseline, and extended with Huffman codes
            0xc0 | 0xc1 => {
                let side =
                    |at: usize| Some(usize::from(u16::from_be_bytes([*segment.get(at)?, *segment.get(at + 1)?])));
                (self.height, self.width) = (side(1)?, side(3)?);
                let (components, _) = segment.get(6..)?.as_chunks::<3>();
                let component = |&[id, sampling, _]: &[u8; 3]| Component {
                    id,
                    horizontal: usize::from(sampling >> 4).max(1),
                    vertical: usize::from(sampling & 15).max(1),
                };
                self.components = components.iter().map(component).collect();
                // a height of 0 follows behind the first scan
                if segment[0] != 8 || self.width == 0 || self.height == 0 {
                    return Some(ControlFlow::Break(()));
                }
            }
            0xc4 => {
                let mut rest = segment;
                while let Some((&[kind, ref counts @ ..], more)) = rest.split_first_chunk::<17>() {
                    let count: usize = counts.iter().map(|&count| usize::from(count)).sum();
                    let table = Table::new(counts, more.get(..count)?);
                    *self.tables.get_mut(usize::from(kind >> 4))?.get_mut(usize::from(kind & 15))? = Some(table);
                    rest = &more[count..];
                }
            }
            0xc2..=0xcf => return Some(ControlFlow::Break(())),
            0xdd => self.restart_interval = usize::from(u16::from_be_bytes([*segment.first()?, *segment.get(1)?])),
            _ => {}
        }
        Some(ControlFlow::Continue(()))
    }

    /// Passes over the data of a scan, which begin at `begin`: where they end, or what is wrong with them. `None` if the header is
    /// none that is understood.
    fn scan(&mut self, header: &[u8], bytes: &[u8], begin: usize) -> Option<Result<usize, String>> {
        let count = usize::from(*header.first()?);
        let (chosen, _) = header.get(1..1 + 2 * count)?.as_chunks::<2>();
        let largest = |of: fn(&Component) -> usize| self.components.iter().map(of).max();
        let (most_across, most_down) = (largest(|one| one.horizontal)?, largest(|one| one.vertical)?);
        let table = |class: usize, number: u8| self.tables[class].get(usize::from(number))?.as_ref();
        let (mut blocks, mut first) = (Vec::new(), None);
        for &[id, numbers] in chosen {
            let component = self.components.iter().find(|component| component.id == id)?;
            first.get_or_insert(component);
            let of_unit = if count == 1 { 1 } else { component.horizontal * component.vertical };
            blocks.extend(vec![(table(0, numbers >> 4)?, table(1, numbers & 15)?); of_unit]);
        }
        let units = match (first?, count) {
            (only, 1) => {
                let across = (self.width * only.horizontal).div_ceil(most_across).div_ceil(8);
                across * (self.height * only.vertical).div_ceil(most_down).div_ceil(8)
            }
            _ => self.width.div_ceil(8 * most_across) * self.height.div_ceil(8 * most_down),
        };
        let mut bits = Bits { bytes, at: begin, buffer: 0, count: 0 };
        for unit in 0..units {
            if self.restart_interval > 0 && unit > 0 && unit % self.restart_interval == 0 {
                if bits.left() > MOST_LEFT {
                    return Some(Err(format!("{} bytes of data are left before a restart", bits.left())));
                }
                bits.at += bits.rest().len();
                if matches!(bytes.get(bits.at + 1), Some(0xd0..=0xd7)) {
                    (bits.at, bits.count) = (bits.at + 2, 0);
                }
            }
            if let Err(wrong) = blocks.iter().try_for_each(|(dc, ac)| bits.block(dc, ac)) {
                let what = match wrong {
                    Wrong::End => "its data end",
                    Wrong::Code => "its data have no meaning",
                };
                return Some(Err(format!("{what} after {} % of its blocks", 100 * unit / units)));
            }
        }
        self.seen += count;
        match bits.left() {
            left if left > MOST_LEFT => Some(Err(format!("{left} bytes of data are left behind its last block"))),
            _ => Some(Ok(bits.at)),
        }
    }

    fn missing(&self) -> Option<String> {
        let is_all = self.seen >= self.components.len();
        (!is_all).then(|| format!("it has {} of {} colours", self.seen, self.components.len()))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use image::codecs::jpeg::JpegEncoder;
    use image::{DynamicImage, GrayImage, ImageFormat, Luma, Rgb, RgbImage};

    use super::*;

    fn noise(x: u32, y: u32) -> Rgb<u8> {
        Rgb([1, 3, 7].map(|factor| (x * x * factor + y * y * 13 + x * y) as u8))
    }

    fn jpeg(image: impl Into<DynamicImage>) -> Vec<u8> {
        let mut bytes = Vec::new();
        image.into().write_to(&mut Cursor::new(&mut bytes), ImageFormat::Jpeg).unwrap();
        bytes
    }

    #[test]
    fn whole_ones_are_whole() {
        for (width, height) in [(1, 1), (8, 8), (17, 9), (161, 120)] {
            for quality in [10, 75, 100] {
                let mut bytes = Vec::new();
                let image = RgbImage::from_fn(width, height, noise);
                image.write_with_encoder(JpegEncoder::new_with_quality(&mut bytes, quality)).unwrap();
                assert_eq!(damage(&bytes), None, "{width} x {height}, {quality}");
            }
            assert_eq!(damage(&jpeg(GrayImage::from_fn(width, height, |x, y| Luma([noise(x, y)[0]])))), None);
            // without detail
            assert_eq!(damage(&jpeg(RgbImage::new(width, height))), None);
        }
        // markers may have fill bytes before them (T.81, B.1.1.2), and some encoders pad
        let whole = jpeg(RgbImage::from_fn(40, 40, noise));
        let (data, end) = whole.split_at(whole.len() - 2);
        assert_eq!([0, 0xff].map(|fill| damage(&[data, &[fill; 600], end].concat())), [None, None]);
        assert_eq!(damage(b"\x89PNG"), None);
        assert_eq!(damage(&[0xff, 0xd8, 0xff]), None);
    }

    #[test]
    fn damage_within_is_seen() {
        let whole = jpeg(RgbImage::from_fn(161, 120, noise));
        let (half, most) = (whole.len() / 2, whole.len() * 3 / 4);
        for (what, bytes) in [
            ("a hole", [&whole[..half], &vec![0; most - half], &whole[most..]].concat()),
            ("an end in the middle", [&whole[..half], &[0xff, 0xd9], &whole[half..]].concat()),
            ("an end too early", [&whole[..half], &[0xff, 0xd9]].concat()),
            ("another file", [&whole[..half], &whole].concat()),
            ("a part left out", [&whole[..half], &whole[most..]].concat()),
            ("a part twice", [&whole[..most], &whole[half..]].concat()),
        ] {
            assert!(damage(&bytes).is_some(), "{what}");
        }
        assert!(damage(&[&whole[..half], &[0xff, 0xd9]].concat()).unwrap().contains("its data end after"));
    }
}
