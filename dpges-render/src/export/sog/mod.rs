//! Splats in a SOG file of version 2 (PlayCanvas): quantised, in lossless WebP pictures with a pixel per splat, from the top
//! left, row by row. The bundled file is a zip archive of the pictures and `meta.json`, which may also lie in a folder.
//!
//! | picture | red, green, blue | alpha |
//! |---|---|---|
//! | `means_l`, `means_u` | low and high bytes of x, y and z as sign(x) ln(\|x\| + 1) between `mins` and `maxs` | 255 |
//! | `quats` | the three smaller components of w, x, y, z in this order, from −1/√2 to 1/√2 | 252 + index of the largest, which is positive |
//! | `scales` | indices of ln s in a codebook of 256 numbers | 255 |
//! | `sh0` | indices of k0 in another | opacity × 255 |
//! | `shN_labels` | low and high bytes of an index in a palette of at most 65,536 | 255 |
//! | `shN_centroids` | 64 entries of the palette side by side, a pixel per coefficient above k0, indices in a third codebook | 255 |
//!
//! Axes are those of PLY, as splat-transform reads and writes them. All that a file says of its scene stands in `asset`.

mod codebook;
mod palette;
mod pixels;
mod streamed;

use std::path::Path;

use dpges_core::scene::{Rendering, SceneInfo, ScreenFilter, along_morton_curve};
use serde::{Deserialize, Serialize};

use self::codebook::Codebook;
use self::palette::palette;
use self::pixels::{Pixels, expand, pack_quaternion, squeeze, to_byte, unpack_quaternion};
use super::archive::{Archive, stored};
use super::cloud::SplatCloud;
use super::error::ExportError;
use super::harmonics::{MAX_DEGREE, coefficient_count};
use super::notes::Notes;
use super::{APPROXIMATION, GENERATOR};

pub use streamed::{INDEX, to_streamed_sog};

const VERSION: u32 = 2;
const META: &str = "meta.json";
/// Keeps the archive below 4 GiB, and pictures within what WebP can be.
const MOST_SPLATS: usize = 1 << 27;
/// As many as splat-transform makes: what two bytes can name.
const LARGEST_PALETTE: usize = 1 << 16;
/// Entries of the palette beside each other.
const ENTRIES_PER_ROW: usize = 64;
const STEPS: f64 = 65_535.0;
/// Opacities are between 0 and 1.
const OPACITIES: [f32; 2] = [1e-6, 1.0 - 1e-6];
/// The model of splats that are made for a low-pass filter that dims what it widens (Mip-Splatting).
const ANTIALIASED: &str = "antialiased";

#[derive(Serialize, Deserialize)]
struct Meta {
    version: u32,
    #[serde(default)]
    asset: Asset,
    count: usize,
    /// How older readers are told of [`ANTIALIASED`].
    #[serde(default)]
    antialias: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    model: Option<String>,
    means: Means,
    scales: Coded,
    quats: Plain,
    sh0: Coded,
    #[serde(rename = "shN", default, skip_serializing_if = "Option::is_none")]
    rest: Option<Rest>,
}

#[derive(Default, Serialize, Deserialize)]
struct Asset {
    #[serde(default)]
    generator: String,
    #[serde(default)]
    note: String,
    #[serde(default)]
    dpges: Option<SceneInfo>,
}

#[derive(Serialize, Deserialize)]
struct Means {
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Serialize, Deserialize)]
struct Plain {
    files: [String; 1],
}

#[derive(Serialize, Deserialize)]
struct Coded {
    codebook: Vec<f32>,
    files: [String; 1],
}

#[derive(Serialize, Deserialize)]
struct Rest {
    count: usize,
    bands: usize,
    codebook: Vec<f32>,
    files: [String; 2],
}

/// The bytes of the bundled file of `cloud`, with its splats in another order, that of a Morton curve.
///
/// # Errors
/// [`ExportError::TooMany`].
pub fn to_sog(cloud: &SplatCloud) -> Result<Vec<u8>, ExportError> {
    if cloud.len() > MOST_SPLATS {
        return Err(ExportError::TooMany { count: cloud.len(), limit: MOST_SPLATS });
    }
    let files = files(&cloud.select(&along_morton_curve(cloud.positions.as_flattened())));
    Ok(stored(files.iter().map(|(name, bytes)| (&**name, &**bytes))))
}

/// The files of a cloud of at least one splat, in its order: names and bytes.
fn files(cloud: &SplatCloud) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    let mut put = |name: &str, pixels: &Pixels| {
        let name = format!("{name}.webp");
        files.push((name.clone(), pixels.to_webp()));
        name
    };
    let squeezed: Vec<[f64; 3]> = cloud.positions.iter().map(|p| p.map(squeeze)).collect();
    let bound = |start: f64, pick: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|axis: usize| squeezed.iter().map(|p| p[axis]).fold(start, pick))
    };
    let (mins, maxs) = (bound(f64::INFINITY, f64::min), bound(f64::NEG_INFINITY, f64::max));
    let steps = |p: &[f64; 3]| {
        // 0 / 0 where all splats share a coordinate: a cast makes it 0
        [0, 1, 2].map(|axis: usize| ((p[axis] - mins[axis]) / (maxs[axis] - mins[axis]) * STEPS).round() as u16)
    };
    let byte = |at: usize| Pixels::of(squeezed.iter().map(|p| opaque(steps(p).map(|step| step.to_le_bytes()[at]))));
    let means = Means { mins, maxs, files: [put("means_l", &byte(0)), put("means_u", &byte(1))] };
    let scales = Codebook::of(cloud.log_scales.iter().flatten().copied());
    let nearest = cloud.log_scales.iter().map(|scales_of| opaque(scales_of.map(|s| scales.nearest(s))));
    let scales_file = put("scales", &Pixels::of(nearest));
    let quats = put("quats", &Pixels::of(cloud.quaternions.iter().map(|&q| pack_quaternion(q))));
    let bases = || (0..cloud.len()).map(|row| cloud.harmonics_of(row)[0]);
    let sh0 = Codebook::of(bases().flatten());
    let colours = bases().zip(&cloud.opacities).map(|(base, &opacity)| {
        let [red, green, blue] = base.map(|k0| sh0.nearest(k0));
        [red, green, blue, to_byte(opacity)]
    });
    let sh0_file = put("sh0", &Pixels::of(colours));
    let rest = (cloud.degree > 0).then(|| rest(cloud, &mut put));
    let antialias = cloud.info.screen_filter == ScreenFilter::Compensated;
    let asset = Asset { generator: GENERATOR.into(), note: APPROXIMATION.into(), dpges: Some(cloud.info.clone()) };
    let meta = Meta {
        version: VERSION,
        asset,
        count: cloud.len(),
        antialias,
        model: antialias.then(|| ANTIALIASED.to_owned()),
        means,
        scales: Coded { codebook: scales.0, files: [scales_file] },
        quats: Plain { files: [quats] },
        sh0: Coded { codebook: sh0.0, files: [sh0_file] },
        rest,
    };
    files.push((META.to_owned(), serde_json::to_vec(&meta).expect("numbers and names become JSON")));
    files
}

/// The coefficients above the base colour.
fn rest(cloud: &SplatCloud, put: &mut impl FnMut(&str, &Pixels) -> String) -> Rest {
    let width = cloud.harmonics_len() - 3;
    let vectors: Vec<f32> =
        (0..cloud.len()).flat_map(|row| cloud.harmonics_of(row)[1..].as_flattened()).copied().collect();
    let largest = 1 << cloud.len().ilog2();
    let (entries, labels) = palette(&vectors, width, LARGEST_PALETTE.min(largest));
    let book = Codebook::of(entries.iter().copied());
    let coefficients = entries.as_chunks::<3>().0.iter().map(|k| opaque(k.map(|k| book.nearest(k))));
    let centroids = Pixels::rows(coefficients, ENTRIES_PER_ROW * width / 3);
    let labels = labels.into_iter().map(|label| {
        let [low, high] = (label as u16).to_le_bytes();
        opaque([low, high, 0])
    });
    Rest {
        count: entries.len() / width,
        bands: cloud.degree,
        codebook: book.0,
        files: [put("shN_centroids", &centroids), put("shN_labels", &Pixels::of(labels))],
    }
}

fn opaque([red, green, blue]: [u8; 3]) -> [u8; 4] {
    [red, green, blue, u8::MAX]
}

/// The splats of a bundled file.
pub(super) fn read(bytes: &[u8]) -> Result<(SplatCloud, Notes), String> {
    let mut archive = Archive::new(bytes)?;
    let meta = archive.file(META).map_err(|reason| format!("{reason}: of zip archives, only bundled SOG is read"))?;
    read_files(&meta, |name| archive.file(name))
}

/// Whether these are the bytes of a `meta.json` beside its pictures.
pub(super) fn is_meta(bytes: &[u8]) -> bool {
    let keys: Option<serde_json::Map<String, serde_json::Value>> = serde_json::from_slice(bytes).ok();
    keys.is_some_and(|keys| ["means", "scales", "quats", "sh0"].iter().all(|key| keys.contains_key(*key)))
}

/// The splats of a `meta.json` with its pictures in `folder`.
pub(super) fn read_unbundled(meta: &[u8], folder: &Path) -> Result<(SplatCloud, Notes), String> {
    read_files(meta, |name| {
        let plain = Path::new(name).file_name().filter(|plain| *plain == name);
        let path = folder.join(plain.ok_or_else(|| format!("`{name}` is no name of a file beside it"))?);
        std::fs::read(&path).map_err(|error| format!("cannot read {}: {error}", path.display()))
    })
}

/// The splats of a `meta.json` and the pictures that `file` has by their names.
fn read_files(
    meta: &[u8],
    mut file: impl FnMut(&str) -> Result<Vec<u8>, String>,
) -> Result<(SplatCloud, Notes), String> {
    let wrong = |error: serde_json::Error| format!("its {META} is not that of SOG of version {VERSION} ({error})");
    let meta: Meta = serde_json::from_slice(meta).map_err(wrong)?;
    if meta.version != VERSION {
        return Err(format!("it has version {}, expected {VERSION}", meta.version));
    }
    let mut pixels = |name: &String| Pixels::from_webp(&file(name)?, name);
    let count = meta.count;
    let mut per_splat = |name: &String| pixels(name)?.take(count, name);
    let [low, high] = [per_splat(&meta.means.files[0])?, per_splat(&meta.means.files[1])?];
    let [scales, quats, sh0] = [&meta.scales.files, &meta.quats.files, &meta.sh0.files].map(|[name]| name);
    let (scales, quats, sh0) = (per_splat(scales)?, per_splat(quats)?, per_splat(sh0)?);
    let rest = match &meta.rest {
        Some(rest) => {
            let labels = per_splat(&rest.files[1])?;
            Some(Palette::new(rest, pixels(&rest.files[0])?, labels)?)
        }
        None => None,
    };
    let position = |(low, high): (&[u8; 4], &[u8; 4])| {
        [0, 1, 2].map(|axis: usize| {
            let share = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / STEPS;
            let Means { mins, maxs, .. } = &meta.means;
            expand(mins[axis] + (maxs[axis] - mins[axis]) * share) as f32
        })
    };
    let looked_up = |pixels: &[[u8; 4]], coded: &Coded| {
        let row = |&[a, b, c, _]: &[u8; 4]| entry(&coded.codebook, [a, b, c]);
        pixels.iter().map(row).collect::<Result<Vec<_>, String>>()
    };
    let (log_scales, bases) = (looked_up(&scales, &meta.scales)?, looked_up(&sh0, &meta.sh0)?);
    let mut harmonics = Vec::new();
    for (row, base) in bases.iter().enumerate() {
        harmonics.extend(base);
        if let Some(rest) = &rest {
            rest.append(row, &mut harmonics)?;
        }
    }
    let antialias = meta.antialias || meta.model.as_deref() == Some(ANTIALIASED);
    let screen_filter = if antialias { ScreenFilter::Compensated } else { ScreenFilter::Plain };
    let foreign = || SceneInfo { screen_filter, rendering: Rendering::Ellipsoids, ..SceneInfo::default() };
    let notes = Notes { own: meta.asset.dpges.is_some(), ..Notes::default() };
    let cloud = SplatCloud {
        positions: low.iter().zip(&high).map(position).collect(),
        quaternions: quats.iter().map(|&pixel| unpack_quaternion(pixel)).collect(),
        log_scales,
        opacities: sh0.iter().map(|pixel| (f32::from(pixel[3]) / 255.0).clamp(OPACITIES[0], OPACITIES[1])).collect(),
        degree: rest.map_or(0, |rest| rest.degree),
        harmonics,
        info: meta.asset.dpges.unwrap_or_else(foreign),
    };
    Ok((cloud, notes))
}

fn entry(codebook: &[f32], at: [u8; 3]) -> Result<[f32; 3], String> {
    match at.into_iter().max() {
        Some(last) if usize::from(last) >= codebook.len() => {
            Err(format!("entry {last} of a codebook of {} is asked for", codebook.len()))
        }
        _ => Ok(at.map(|at| codebook[usize::from(at)])),
    }
}

/// Coefficients above the base colour, as they are stored.
struct Palette<'a> {
    codebook: &'a [f32],
    degree: usize,
    centroids: Vec<[u8; 4]>,
    labels: Vec<[u8; 4]>,
}

impl<'a> Palette<'a> {
    fn new(rest: &'a Rest, centroids: Pixels, labels: Vec<[u8; 4]>) -> Result<Self, String> {
        if !(1..=MAX_DEGREE).contains(&rest.bands) {
            return Err(format!("harmonics of degree {} cannot be read", rest.bands));
        }
        let per_entry = coefficient_count(rest.bands) - 1;
        if centroids.width != ENTRIES_PER_ROW * per_entry {
            let expected = ENTRIES_PER_ROW * per_entry;
            return Err(format!("`{}` is {} pixels wide, expected {expected}", rest.files[0], centroids.width));
        }
        let centroids = centroids.take(rest.count.saturating_mul(per_entry), &rest.files[0])?;
        Ok(Self { codebook: &rest.codebook, degree: rest.bands, centroids, labels })
    }

    fn append(&self, row: usize, harmonics: &mut Vec<f32>) -> Result<(), String> {
        let per_entry = coefficient_count(self.degree) - 1;
        let label = usize::from(u16::from_le_bytes([self.labels[row][0], self.labels[row][1]]));
        let pixels = self.centroids.get(label * per_entry..(label + 1) * per_entry);
        let count = self.centroids.len() / per_entry;
        let pixels = pixels.ok_or_else(|| format!("entry {label} of a palette of {count} is asked for"))?;
        for &[a, b, c, _] in pixels {
            harmonics.extend(entry(self.codebook, [a, b, c])?);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
