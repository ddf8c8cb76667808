use std::path::PathBuf;

use ::e57::{E57Writer, Quaternion, Record, RecordDataType, RecordName, RecordValue, Transform, Translation};
use ::las::point::{Classification, Format};
use ::las::{Builder, Color, Point, Vector, Writer};
use tempfile::TempDir;

use super::*;
use crate::LoadOptions;
use crate::fixtures::{Encoding, assert_refused, assert_says, colmap_folder, said, scene};
use crate::load;

const ORIGIN: DVec3 = DVec3::new(512_345.25, 5_412_345.5, 300.125);
const GREY: [f32; 3] = [0.5; 3];

fn place(folder: &TempDir, name: &str) -> PathBuf {
    folder.path().join(name)
}

/// Writes a survey with steps of 1/1024 at [`ORIGIN`].
fn write_las(path: &Path, format: u8, points: &[(DVec3, u16, Option<[u16; 3]>, Classification)]) {
    let mut builder = Builder::from((1, 4));
    builder.point_format = Format::new(format).unwrap();
    let axis = |offset: f64| ::las::Transform { scale: 1.0 / 1024.0, offset };
    builder.transforms = Vector { x: axis(ORIGIN.x), y: axis(ORIGIN.y), z: axis(ORIGIN.z) };
    let mut writer = Writer::from_path(path, builder.into_header().unwrap()).unwrap();
    for &(position, intensity, colour, classification) in points {
        let color = colour.map(|[red, green, blue]| Color { red, green, blue });
        let gps_time = Format::new(format).unwrap().has_gps_time.then_some(0.0);
        let [x, y, z] = position.to_array();
        writer.write_point(Point { x, y, z, intensity, color, classification, gps_time, ..Point::default() }).unwrap();
    }
    writer.close().unwrap();
}

#[test]
fn surveys_keep_their_place_to_the_last_step_and_their_colours() {
    let folder = tempfile::tempdir().unwrap();
    let step = DVec3::new(1.0 / 1024.0, -0.5, 7.25);
    let ground = Classification::Ground;
    for (name, format) in [("survey.las", 2), ("survey.laz", 2), ("new.laz", 7)] {
        let path = place(&folder, name);
        let of = |at: DVec3, colour| (at, 9, Some(colour), ground);
        let noise = (ORIGIN, 9, Some([0; 3]), Classification::LowPoint);
        write_las(&path, format, &[of(ORIGIN, [65535, 0, 13107]), noise, of(ORIGIN + step, [0, 26214, 65535])]);
        let (kind, kept, white) = offered(&path, 10).unwrap();
        assert_eq!((kind, kept.all, kept.invalid), ("LAS", 3, 1), "{name}");
        let points = kept.into_points(white);
        assert_eq!(points.positions, [ORIGIN, ORIGIN + step], "{name}");
        assert_eq!(points.colours, [[1.0, 0.0, 0.2], [0.0, 0.4, 1.0]], "{name}");
    }
    let path = place(&folder, "other.las");
    let colours = |format: u8, intensities: [u16; 2], colours: [Option<[u16; 3]>; 2]| {
        let rows = [0, 1].map(|row| (ORIGIN + step * row as f64, intensities[row], colours[row], ground));
        write_las(&path, format, &rows);
        let (_, kept, white) = offered(&path, 10).unwrap();
        kept.into_points(white).colours
    };
    assert_eq!(colours(2, [0; 2], [Some([255, 51, 0]), Some([0; 3])]), [[1.0, 0.2, 0.0], [0.0; 3]], "8 bits");
    assert_eq!(colours(0, [200, 50], [None; 2]), [[1.0; 3], [0.25; 3]], "intensities");
    assert_eq!(colours(2, [200, 50], [Some([0; 3]); 2]), [GREY; 2], "never coloured");
    assert_eq!(colours(0, [0; 2], [None; 2]), [GREY; 2], "nothing");
}

fn record(name: RecordName, data_type: RecordDataType) -> Record {
    Record { name, data_type }
}

fn write_e57(path: &Path) {
    let mut file = E57Writer::from_file(path, "file").unwrap();
    let state = record(RecordName::CartesianInvalidState, RecordDataType::Integer { min: 0, max: 2 });
    let red = [RecordName::ColorRed, RecordName::ColorGreen, RecordName::ColorBlue];
    let cartesian = vec![Record::CARTESIAN_X_F64, Record::CARTESIAN_Y_F64, Record::CARTESIAN_Z_F64, state];
    let colours = red.map(|name| record(name, RecordDataType::U8));
    let mut scan = file.add_pointcloud("first", [cartesian, colours.to_vec()].concat()).unwrap();
    // a quarter turn about z
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let rotation = Quaternion { w: half, x: 0.0, y: 0.0, z: half };
    let translation = Translation { x: ORIGIN.x, y: ORIGIN.y, z: ORIGIN.z };
    scan.set_transform(Some(Transform { rotation, translation }));
    for (position, state, colour) in [([1.0, 0.0, 2.0], 0, [255, 51, 0]), ([3.0; 3], 1, [9; 3]), ([4.0; 3], 2, [9; 3])]
    {
        let position = position.map(RecordValue::Double);
        let colour = colour.map(RecordValue::Integer);
        scan.add_point([&position[..], &[RecordValue::Integer(state)], &colour].concat()).unwrap();
    }
    scan.finalize().unwrap();
    let spherical = [RecordName::SphericalRange, RecordName::SphericalAzimuth, RecordName::SphericalElevation];
    let spherical = spherical.map(|name| record(name, RecordDataType::F64)).to_vec();
    let intensity = record(RecordName::Intensity, RecordDataType::UNIT_F32);
    let mut scan = file.add_pointcloud("second", [spherical, vec![intensity]].concat()).unwrap();
    let (above, half) = (std::f64::consts::FRAC_PI_2, RecordValue::Single(0.25));
    scan.add_point(vec![RecordValue::Double(2.0), RecordValue::Double(0.0), RecordValue::Double(above), half]).unwrap();
    scan.finalize().unwrap();
    file.finalize().unwrap();
}

#[test]
fn scans_are_where_their_poses_put_them_without_invalid_points() {
    let folder = tempfile::tempdir().unwrap();
    let path = place(&folder, "room.e57");
    write_e57(&path);
    let (kind, kept, white) = offered(&path, 10).unwrap();
    assert_eq!((kind, kept.all, kept.invalid), ("E57", 4, 2));
    let points = kept.into_points(white);
    let expected = [ORIGIN + DVec3::new(0.0, 1.0, 2.0), DVec3::new(0.0, 0.0, 2.0)];
    for (found, expected) in points.positions.iter().zip(expected) {
        assert!(found.distance(expected) < 1e-8, "{found}, expected {expected}");
    }
    assert_eq!(points.colours, [[1.0, 0.2, 0.0], [0.25; 3]]);
}

fn ply(points: &[[f64; 3]]) -> String {
    let rows: String = points.iter().map(|[x, y, z]| format!("{x} {y} {z}\n")).collect();
    let columns = ["x", "y", "z"].map(|name| format!("property double {name}\n")).concat();
    format!("ply\nformat ascii 1.0\nelement vertex {}\n{columns}end_header\n{rows}", points.len())
}

#[test]
fn clouds_that_are_no_use_are_refused_by_name() {
    let dataset = colmap_folder(&scene(9), Encoding::Text);
    let folder = tempfile::tempdir().unwrap();
    let refused = |name: &str, parts: &[&str]| {
        let options = LoadOptions { points: Some(place(&folder, name)), ..LoadOptions::default() };
        assert_refused(dataset.path(), &options, &[&[name, "data.points"], parts].concat());
    };
    refused("absent.las", &["cannot be read"]);
    let write = |name: &str, bytes: &[u8]| std::fs::write(place(&folder, name), bytes).unwrap();
    write("empty.e57", b"");
    refused("empty.e57", &["not PLY, LAS, LAZ or E57"]);
    write("points.xyz", b"1 2 3\n4 5 6\n");
    refused("points.xyz", &["1 2 3", "export them as one of these"]);
    write_e57(&place(&folder, "whole.e57"));
    let colour = Some([9; 3]);
    let points: Vec<_> =
        (0..50).map(|at| (ORIGIN + DVec3::X * f64::from(at), 0, colour, Classification::Ground)).collect();
    for name in ["whole.las", "whole.laz"] {
        write_las(&place(&folder, name), 2, &points);
    }
    for (whole, kind) in [("whole.e57", "E57"), ("whole.las", "LAS"), ("whole.laz", "LAS")] {
        let bytes = std::fs::read(place(&folder, whole)).unwrap();
        let cut = whole.replace("whole", "cut");
        write(&cut, &bytes[..bytes.len() - 20]);
        refused(&cut, &["truncated or corrupt", kind]);
    }
    let mut bytes = std::fs::read(place(&folder, "whole.laz")).unwrap();
    let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let chunks = number(number(96)) + 4;
    bytes[chunks..chunks + 4].fill(0xff);
    write("chunks.laz", &bytes);
    refused("chunks.laz", &["more chunks than bytes"]);
    write("cut.ply", &ply(&[[0.0; 3], [1.0; 3]]).as_bytes()[..107]);
    refused("cut.ply", &["truncated or corrupt PLY"]);
    write("nan.ply", ply(&[[f64::NAN; 3]; 3]).as_bytes());
    refused("nan.ply", &["3 of 3 are invalid"]);
    write("alike.ply", ply(&[[0.25; 3]; 3]).as_bytes());
    refused("alike.ply", &["two different points", "at one place"]);
    write("none.ply", ply(&[]).as_bytes());
    refused("none.ply", &["0 of 0"]);
    refused("whole.las", &["are in no picture", "x 512345.250 to 512394.250", "cameras in x -2.8", "same offset"]);
}

#[test]
fn a_cloud_takes_the_place_of_the_points_and_doubtful_frames_are_named() {
    let dataset = colmap_folder(&scene(9), Encoding::Text);
    let folder = tempfile::tempdir().unwrap();
    let path = place(&folder, "cloud.ply");
    let with = |scale: f64| {
        let along = |at: i32| f64::from(at) / 200.0;
        let points: Vec<[f64; 3]> =
            (0..200).map(|at| [1.2 * scale * along(at) - 0.5, 0.125, -0.8 * along(at)]).collect();
        std::fs::write(&path, ply(&[&points[..], &[[f64::NAN; 3]]].concat())).unwrap();
        load(dataset.path(), &LoadOptions { points: Some(path.clone()), ..LoadOptions::default() }).unwrap()
    };
    let data = with(1.0);
    assert_eq!((data.points.positions.len(), data.points.positions[0]), (200, [-0.5, 0.125, 0.0]));
    assert_eq!(data.points.colours, vec![GREY; 200]);
    let own = load(dataset.path(), &LoadOptions::default()).unwrap().points;
    let seen_by = |at: usize| data.points.seen_by.of(at);
    assert!((0..4).all(|at| seen_by(50 * at) == own.seen_by.of(at)) && seen_by(0).len() + seen_by(50).len() > 1);
    assert!(seen_by(25).is_empty());
    let text = said(&data);
    assert_says(&text, &["cloud.ply (PLY): 200 of 201", "without 1 invalid"]);
    assert!(!text.contains("of the extent"), "{text}");
    // a thousand times as large
    assert_says(said(&with(1000.0)), &["from measured ones", "of the extent"]);
}
