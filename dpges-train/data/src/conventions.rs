//! File kinds by name and first bytes: the conventions of the programs that write them.

use super::error::text_of;
use super::key::{extension, parent, stem};

/// Extensions of pictures that are read.
pub const READ: [&str; 4] = ["jpg", "jpeg", "png", "webp"];
/// Extensions of pictures that are not, in lower case.
pub const UNREAD: [&str; 25] = [
    "heic", "heif", "avif", "jxl", "jp2", "tif", "tiff", "bmp", "gif", "tga", "pgm", "ppm", "exr", "hdr", "dng", "cr2",
    "cr3", "crw", "nef", "nrw", "arw", "raf", "rw2", "orf", "pef",
];
/// Extensions of masks and depth maps that are no pictures.
pub const ARRAYS: [&str; 4] = ["npy", "npz", "pfm", "bin"];
/// Beginnings of files of pictures that are not read: where the bytes are, the bytes, the format.
const BEGINNINGS: [(usize, &[u8], &str); 10] = [
    (4, b"ftyp", "HEIC, AVIF or CR3"),
    (0, b"II*\0", "TIFF or raw"),
    (0, b"MM\0*", "TIFF or raw"),
    (0, b"\x76\x2f\x31\x01", "EXR"),
    (0, b"#?RADIANCE", "HDR"),
    (0, b"GIF8", "GIF"),
    (0, b"BM", "BMP"),
    (0, b"\xff\x0a", "JPEG XL"),
    (4, b"JXL ", "JPEG XL"),
    (0, b"version https://git-lfs", "Git LFS (a pointer to the picture)"),
];

/// The format of a picture that is not read, by its first bytes.
pub fn unread_format(beginning: &[u8]) -> Option<&'static str> {
    let begins =
        |&&(at, bytes, _): &&(usize, &[u8], &str)| beginning.get(at..).is_some_and(|rest| rest.starts_with(bytes));
    BEGINNINGS.iter().find(begins).map(|&(.., format)| format)
}

pub fn is_read(key: &str) -> bool {
    READ.contains(&extension(key))
}

pub fn is_picture(key: &str) -> bool {
    is_read(key) || UNREAD.contains(&extension(key))
}

/// Pictures that belong to photographs: they lie beside them, or in a folder beside that of the photographs, and are called alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Companion {
    /// Names of such folders; they may end in `_` and a scale.
    folders: &'static [&'static str],
    /// Beginning or end of the name, without its extension, parted from the name of the photograph by one of `._-`.
    affix: &'static str,
    /// Parts of the names of other folders that hold such pictures.
    words: &'static [&'static str],
}

pub const MASKS: Companion = Companion { folders: &["masks", "mask"], affix: "mask", words: &["mask", "segmentation"] };
pub const DEPTHS: Companion =
    Companion { folders: &["depths", "depth", "depth_maps"], affix: "depth", words: &["depth", "disparit"] };

impl Companion {
    /// The place of a file among those that may belong to a photograph, the first of which is taken, and the photograph, by the
    /// [`subject`] of its key with or without its extension; none if it is no such file. `scale` is that of the photographs.
    pub fn subjects(&self, key: &str, scale: &str) -> Vec<(usize, String)> {
        let folders = key.split('/').rev().skip(1);
        let rank = |part: &str| {
            let of = |name: &str| [part.strip_prefix(name) == Some(scale), part == name];
            let ranks = self.folders.iter().map(|name| of(name)).enumerate();
            ranks.flat_map(|(at, [scaled, plain])| [scaled.then_some(at), plain.then_some(4 + at)]).flatten().min()
        };
        let in_folder = folders.filter_map(rank).min();
        let subject = |name: &str| {
            let (above, _) = parent(key);
            subject_of(&if above.is_empty() { name.to_owned() } else { format!("{above}/{name}") }, self.folders)
        };
        let name = stem(parent(key).1);
        let bare = ["_", ".", "-"].iter().find_map(|part| {
            let end = name.strip_suffix(self.affix).and_then(|rest| rest.strip_suffix(part));
            end.or_else(|| name.strip_prefix(self.affix).and_then(|rest| rest.strip_prefix(part)))
        });
        let plain = in_folder.map(|rank| (rank, subject(name)));
        plain.into_iter().chain(bare.map(|bare| (8 + in_folder.unwrap_or(8), subject(bare)))).collect()
    }

    /// Whether a file is one of such pictures, or lies in a folder that is called like one.
    pub fn is_about(&self, key: &str) -> bool {
        let is_called_so = |part: &str| self.words.iter().any(|word| part.contains(word));
        parent(key).0.split('/').any(is_called_so) || !self.subjects(key, "").is_empty()
    }
}

/// The key of a photograph without the folders that hold those of a dataset, for comparison with [`Companion::subjects`].
pub fn subject(key: &str) -> String {
    subject_of(key, &[])
}

fn subject_of(key: &str, folders: &[&str]) -> String {
    let (above, name) = parent(key);
    let is_base = |part: &str| {
        ["images", "input"].iter().chain(folders).any(|base| part.strip_prefix(base).is_some_and(is_scale))
    };
    above.split('/').filter(|part| !part.is_empty() && !is_base(part)).chain([name]).collect::<Vec<_>>().join("/")
}

/// Whether it is empty, or `_` and a number.
fn is_scale(text: &str) -> bool {
    text.strip_prefix('_').map_or(text.is_empty(), |number| number.parse::<u32>().is_ok())
}

/// Whether a picture belongs to a photograph, and is none.
pub fn is_companion(key: &str) -> bool {
    [MASKS, DEPTHS].iter().any(|kind| kind.is_about(key))
}

/// Extensions of files, what they say, and the program that keeps its cameras so.
const CAMERAS: [(&str, &str, &str); 16] = [
    ("json", "\"transform_matrix\"", "transforms under another name"),
    ("json", "\"img_name\"", "3DGS"),
    ("json", "\"shots\"", "OpenSfM"),
    ("json", "\"sfm_data_version\"", "OpenMVG"),
    ("json", "\"t_00\"", "Polycam"),
    ("json", "\"perFrameIntrinsicCoeffs\"", "Record3D"),
    ("sfm", "\"poses\"", "Meshroom"),
    ("xml", "<chunk", "Metashape"),
    ("xml", "<BlocksExchange", "ContextCapture"),
    ("xmp", "xcr:", "RealityScan"),
    ("out", "# Bundle file", "Bundler"),
    ("nvm", "NVM_V3", "VisualSFM"),
    ("npy", ", 17)", "LLFF"),
    ("npz", "world_mat", "NeuS"),
    ("txt", "extrinsic\n", "MVSNet"),
    ("txt", "fileName imageWidth", "Pix4D"),
];
/// Extensions of files of points.
pub const POINTS: [&str; 9] = ["ply", "pcd", "las", "laz", "e57", "xyz", "pts", "spz", "splat"];
/// Names of PLY files of points beside cameras that do not name theirs.
pub const CLOUDS: [&str; 6] = ["points3d", "sparse_pc", "points", "pointcloud", "point_cloud", "sparse"];

/// Extensions of files that may hold cameras.
pub fn may_hold_cameras(key: &str) -> bool {
    extension(key) == "csv" || CAMERAS.iter().any(|(of, ..)| *of == extension(key))
}

/// Columns that a table of RealityScan's cameras has.
pub const OF_REALITYSCAN: [&str; 8] = ["name", "x", "y", "alt", "heading", "pitch", "roll", "f"];

/// The columns of a table, in small letters, and what parts them, if a line is the head of one of RealityScan: as it writes it, with
/// `#name` first, or as a spreadsheet saves it again.
pub fn columns_of_realityscan(line: &str) -> Option<(Vec<String>, char)> {
    let part = [',', ';', '\t'].into_iter().max_by_key(|&part| (line.matches(part).count(), part == ','))?;
    let plain = |column: &str| column.trim_matches(['#', '"', ' ', '\r']).to_lowercase();
    let columns: Vec<String> = line.split(part).map(plain).collect();
    let has = |name: &str| columns.iter().any(|column| column == name);
    let is_its_own = columns[0] == "name" && line.trim_start_matches(['"', ' ']).starts_with('#');
    (is_its_own || OF_REALITYSCAN.into_iter().all(has)).then_some((columns, part))
}

/// The program whose cameras a file holds, by its extension and its beginning.
pub fn cameras_of(key: &str, beginning: &[u8]) -> Option<&'static str> {
    let text = text_of(beginning);
    if extension(key) == "csv" {
        return text.lines().find_map(columns_of_realityscan).map(|_| "RealityScan");
    }
    // lists of reconstructions, of which there may be none; the shots may come behind many points
    let is_list = extension(key) == "json" && text.trim_start().starts_with('[');
    if is_list && (text.contains("\"projection_type\"") || stem(parent(key).1) == "reconstruction") {
        return Some("OpenSfM");
    }
    let holds = |(of, words, _): &&(&str, &str, &str)| *of == extension(key) && text.contains(words);
    CAMERAS.iter().find(holds).map(|&(.., program)| program)
}
