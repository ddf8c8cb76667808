//! Clouds of surveys: LAS and LAZ of the ASPRS, with their scales and offsets.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use glam::DVec3;
use las::point::Classification;
use las::{PointDataBuilder, Reader};

use super::kept::Kept;

/// Bytes of points that are decoded at a time, however long a broken header says that a point is.
const BATCH_BYTES: u64 = 1 << 26;

/// Offers all points but those that are withheld or noise. Returns the white of their colours: that of 16 bits, or of 8 bits, which some
/// programs write; without colours intensities stand for them, up to the largest.
pub(super) fn read(path: &Path, kept: &mut Kept) -> las::Result<f32> {
    check_chunks(path)?;
    let mut reader = Reader::from_path(path)?;
    let mut batch = PointDataBuilder::new().for_header(reader.header()).build();
    let format = *reader.header().point_format();
    let points = (BATCH_BYTES / u64::from(format.len()).max(1)).max(1);
    while reader.fill_points(points, &mut batch)? > 0 {
        for point in batch.points() {
            let point = point?;
            let noise = [Classification::LowPoint, Classification::HighNoise].contains(&point.classification);
            let position = (!noise && !point.is_withheld).then(|| DVec3::new(point.x, point.y, point.z));
            let intensity = [f32::from(point.intensity); 3];
            let colour = point.color.map_or(intensity, |colour| [colour.red, colour.green, colour.blue].map(f32::from));
            kept.offer(position, colour);
        }
    }
    Ok(match kept.brightest() {
        // all black says that nothing was coloured: 0 / 0 is grey
        brightest if brightest == 0.0 || !format.has_color => brightest,
        brightest if brightest <= 255.0 => 255.0,
        _ => 65535.0,
    })
}

/// Refuses a LAZ file with more chunks than bytes: memory for all of them would be asked for before the first is read.
fn check_chunks(path: &Path) -> io::Result<()> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut number = |at: u64| -> io::Result<u64> {
        let mut bytes = [0; 4];
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(&mut bytes)?;
        Ok(u32::from_le_bytes(bytes).into())
    };
    // the upper bits of the point format say that points are compressed
    if number(104)? & 0xc0 == 0 {
        return Ok(());
    }
    let points = number(96)?;
    let place = |[low, high]: [u64; 2]| high << 32 | low;
    let table = match place([number(points)?, number(points + 4)?]) {
        // it was not known yet
        u64::MAX => place([number(length - 8)?, number(length - 4)?]),
        table => table,
    };
    if table < length && number(table + 4)? > length {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it has more chunks than bytes"));
    }
    Ok(())
}
