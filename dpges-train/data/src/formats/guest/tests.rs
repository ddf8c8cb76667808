//! Each format by a scene that COLMAP's reader reads, too, and by the formulas of its documentation written out.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use dpges_core::camera::Camera;
use glam::{DMat3, DQuat, DVec3};
use tempfile::TempDir;

use crate::fixtures::{
    self, Encoding, FixtureScene, assert_refused, assert_says, colmap_folder, said, write_colmap, write_png,
};
use crate::{Dataset, Format, LoadOptions, load};

/// fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 of COLMAP.
const BROWN: (u32, &str, [f64; 12]) =
    (6, "FULL_OPENCV", [20.0, 19.0, 12.6, 7.7, -0.05, 0.01, 0.002, -0.003, 0.004, 0.0, 0.0, 0.0]);
/// fx, fy, cx, cy, k1 to k4.
const FISHEYE: (u32, &str, [f64; 8]) = (5, "OPENCV_FISHEYE", [15.0, 15.5, 11.5, 8.4, 0.03, -0.01, 0.002, 0.001]);
/// f, cx, cy, k1, k2.
const RADIAL: (u32, &str, [f64; 5]) = (3, "RADIAL", [21.0, 12.0, 8.0, -0.04, 0.015]);

fn options() -> LoadOptions {
    LoadOptions { undistort: false, near: Some(0.01), ..LoadOptions::default() }
}

/// For a single view.
fn alone() -> LoadOptions {
    LoadOptions { test_every: 0, ..options() }
}

/// Nine views with a lens, as COLMAP's reader finds them, and a folder with their photographs alone.
fn scene<const N: usize>((id, model, params): (u32, &'static str, [f64; N])) -> (TempDir, FixtureScene, Dataset) {
    let mut scene = fixtures::scene(9);
    (scene.model, scene.params) = ((id, model), params.to_vec());
    let folder = colmap_folder(&scene, Encoding::Text);
    let data = load(folder.path(), &options()).unwrap();
    std::fs::remove_dir_all(folder.path().join("sparse")).unwrap();
    (folder, scene, data)
}

/// By name without folders and extension.
fn cameras(data: &Dataset) -> BTreeMap<String, Camera> {
    let stem = |name: &str| Path::new(name).file_stem().unwrap().to_string_lossy().into_owned();
    data.views().map(|view| (stem(&view.name), view.camera)).collect()
}

#[track_caller]
fn assert_same(found: &Dataset, expected: &Dataset) {
    let (found, expected) = (cameras(found), cameras(expected));
    assert_eq!(found.len(), expected.len());
    found.iter().for_each(|(name, camera)| assert_same_camera(camera, &expected[name]));
}

#[track_caller]
fn assert_same_camera(found: &Camera, expected: &Camera) {
    let json = |camera: &Camera| serde_json::to_string(camera).unwrap();
    let numbers = |json: &str| -> Vec<f64> {
        json.split(['[', ']', ',', ':', '}']).filter_map(|word| word.parse().ok()).collect()
    };
    let (found, expected) = (json(found), json(expected));
    let pairs = numbers(&found).into_iter().zip(numbers(&expected));
    let is_same = found.contains("perspective") == expected.contains("perspective") && pairs.len() > 30;
    assert!(is_same && pairs.clone().all(|(a, b)| (a - b).abs() < 1e-6), "{found}\n{expected}");
}

fn rows(matrix: DMat3) -> String {
    matrix.transpose().to_cols_array().map(|number| number.to_string()).join(" ")
}

fn words(vector: DVec3) -> String {
    vector.to_array().map(|number| number.to_string()).join(" ")
}

/// `images/a.png` of 24 × 16 px, and files.
fn dataset(files: &[(&str, &str)]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    write_png(&folder.path().join("images/a.png"), 24, 16, [9; 3]);
    for (name, content) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, content).unwrap();
    }
    folder
}

/// Checks where the only camera of the files shows a point.
#[track_caller]
fn assert_projects(files: &[(&str, &str)], world: [f64; 3], [x, y]: [f64; 2]) {
    let found = load(dataset(files).path(), &alone()).unwrap().train[0].camera.project(world.into()).unwrap();
    assert!((found.0 - x).abs() < 1e-8 && (found.1 - y).abs() < 1e-8, "{found:?} for {x}, {y}");
}

const FRAME: &str = "<sensor id='0' label='A' type='frame'><resolution width='24' height='16'/><calibration type='frame' \
    class='initial'><f>9</f></calibration><calibration type='frame' class='adjusted'><resolution width='24' height='16'/>\
    <f>19</f><b1>1</b1><cx>0.6</cx><cy>-0.3</cy><k1>-0.05</k1><k2>0.01</k2><k3>0.004</k3><p1>-0.003</p1><p2>0.002</p2>\
    </calibration></sensor>";
const WIDE: &str = "<sensor id='1' label='B' type='fisheye'><resolution width='24' height='16'/><calibration type='fisheye'>\
    <f>15.5</f><b1>-0.5</b1><cx>-0.5</cx><cy>0.4</cy><k1>0.03</k1><k2>-0.01</k2><k3>0.002</k3><k4>0.001</k4></calibration>\
    </sensor>";
const IDENTITY: &str = "<transform>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</transform>";

fn metashape(sensors: &str, cameras: &str) -> String {
    format!(
        "<?xml version='1.0'?><document version='2.0.0'><chunk label='c'><sensors>{sensors}</sensors><cameras>{cameras}\
         </cameras></chunk></document>"
    )
}

#[test]
fn metashape_has_chunks_sensors_and_cameras_that_are_not_aligned() {
    let (folder, scene, brown) = scene(BROWN);
    let (_folder, _, fisheye) = self::scene(FISHEYE);
    // world = 2.5 R chunk + t
    let (scale, turn) = (2.5, DMat3::from_rotation_z(0.4) * DMat3::from_rotation_x(-1.1));
    let place = DVec3::new(10.0, -20.0, 5.0);
    let mut list = "<camera id='90' sensor_id='0' label='lost'/>".to_owned();
    for (index, image) in scene.images.iter().enumerate() {
        let chunk_from_camera = turn.transpose() * image.pose.rotation.transpose();
        let centre = turn.transpose() * (image.pose.centre() - place) / scale;
        let rows: Vec<String> = (0..3).map(|i| format!("{} {}", words(chunk_from_camera.row(i)), centre[i])).collect();
        let number = &image.name[5..8];
        let odd = number.parse::<usize>().unwrap() % 2;
        // labels with an extension, of any case, and without
        let label = if odd == 1 { number.to_owned() } else { format!("{number}.PNG") };
        let pose = format!("<transform>{} 0 0 0 1</transform>", rows.join(" "));
        list += &format!("<camera id='{index}' sensor_id='{odd}' component_id='0' label='{label}'>{pose}</camera>");
    }
    let (rotation, translation) = (rows(turn), words(place));
    let component = format!(
        "<components><component id='0'><transform><rotation>{rotation}</rotation><translation>{translation}</translation>\
         <scale>{scale}</scale></transform></component></components>"
    );
    let xml = metashape(&format!("{FRAME}{WIDE}"), &list).replace("<cameras>", &format!("{component}<cameras>"));
    let path = folder.path().join("export.xml");
    std::fs::write(&path, &xml).unwrap();
    let data = load(folder.path(), &options()).unwrap();
    assert_eq!((data.format.to_string().as_str(), data.train.len()), ("Metashape", 7));
    let (found, [brown, fisheye]) = (cameras(&data), [cameras(&brown), cameras(&fisheye)]);
    for (name, camera) in &found {
        let expected = if name.parse::<usize>().unwrap() % 2 == 1 { &fisheye } else { &brown };
        assert_same_camera(camera, &expected[name]);
    }
    assert_says(said(&data), &["Missing: cameras have no position, and are left out (1): lost"]);
    assert_eq!(load(&path, &options()).unwrap().train.len(), 7);
    // most of them in another component, where the chunk has no place of its own
    let apart = xml.replacen("component_id='0'", "component_id='1'", 8);
    std::fs::write(&path, apart.replace("<camera id='0'", "<camera enabled='0' id='0'")).unwrap();
    let data = load(folder.path(), &options()).unwrap();
    assert_eq!(data.views().count(), 7);
    assert_says(said(&data), &["not enabled are left out (1): 008.PNG", "or components are left out (1): 000.PNG"]);
}

#[test]
fn metashape_projects_as_its_manual_says() {
    let xml = metashape(FRAME, &format!("<camera sensor_id='0' label='a'>{IDENTITY}</camera>"));
    let [x, y]: [f64; 2] = [0.3, -0.2];
    let r2 = x * x + y * y;
    let radial = 1.0 - 0.05 * r2 + 0.01 * r2 * r2 + 0.004 * r2 * r2 * r2;
    let (p1, p2) = (-0.003, 0.002);
    let bent_x = x * radial + p1 * (r2 + 2.0 * x * x) + 2.0 * p2 * x * y;
    let bent_y = y * radial + p2 * (r2 + 2.0 * y * y) + 2.0 * p1 * x * y;
    let expected = [12.0 + 0.6 + bent_x * (19.0 + 1.0), 8.0 - 0.3 + bent_y * 19.0];
    assert_projects(&[("cameras.xml", &xml)], [2.0 * x, 2.0 * y, 2.0], expected);
    // little shear is said
    let folder = dataset(&[("cameras.xml", &xml.replace("<b1>", "<b2>0.2</b2><b1>"))]);
    assert_says(said(&load(folder.path(), &alone()).unwrap()), &["`b2` of sensor `A`, up to 0.08 px"]);
    let transposed = xml.replace(IDENTITY, "<transform>1 0 0 0 0 1 0 0 0 0 1 0 2 3 4 1</transform>");
    let folder = dataset(&[("cameras.xml", &transposed)]);
    assert_refused(folder.path(), &alone(), &["the last row of the transform of camera `a`", "transposed?"]);
    // two cameras of one name
    let twice = xml.replace("<cameras>", &format!("<cameras><camera sensor_id='0' label='a'>{IDENTITY}</camera>"));
    let folder = dataset(&[("cameras.xml", &twice)]);
    assert_refused(folder.path(), &alone(), &["cameras.xml", "`a` is that of several cameras"]);
}

const COLUMNS: &str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2";
const ROW: &str = "a.png,1,2,3,170.3,85.2,-22.7,30,0.02,-0.01,-0.08,0.02,-0.01,0.003,0.004,-0.006";
/// World to camera by Epic's formula, in the same pose.
const ROTATION: &str = "-0.974142026742 0.223616976845 0.032291785351 -0.014098827906 0.082481540459 -0.996492859250 \
    -0.225496196833 -0.971180849868 -0.077195997718";

#[test]
fn realityscan_projects_as_its_documentation_says() {
    // from (1, 2, 3) to the east, with the horizon level
    let row = "a.png,1,2,3,90,90,0,30,0,0,0,0,0,0,0,0";
    let table = format!("#cameras 1\n{COLUMNS}\n{row}\n");
    let focal = 30.0 / 36.0 * 24.0;
    // 10 before it, 1 to the south, 2 up
    let (world, at) = ([11.0, 1.0, 5.0], [12.0 + 0.1 * focal, 8.0 - 0.2 * focal]);
    assert_projects(&[("cams.csv", &table)], world, at);
    // as other programs save it again
    let [plain, spaced] = ["name", "# name"].map(|name| format!("{}\n{row}\n", COLUMNS.replace("#name", name)));
    let quoted = format!("{}\n{row}\n", COLUMNS.replace("#name", "\"name\"")).replace("a.png", "\"a.png\"");
    for table in [&plain, &spaced, &quoted, &plain.replace(',', ";"), &plain.replace(',', "\t")] {
        assert_projects(&[("cams.csv", table)], world, at);
    }
    // a table of places is none of cameras
    let places = dataset(&[("places.csv", "name,lat,lon,alt,heading,pitch,roll\na.png,1,2,3,4,5,6\n")]);
    assert_eq!(crate::format(places.path()), None);
    let folder = dataset(&[]);
    let utf16: Vec<u8> = format!("\u{feff}{table}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    std::fs::write(folder.path().join("cams.csv"), utf16).unwrap();
    assert_eq!(load(folder.path(), &alone()).unwrap().format, Format::RealityScan);

    let rotation: Vec<f64> = ROTATION.split(' ').map(|number| number.parse().unwrap()).collect();
    let rotation = DMat3::from_cols_slice(&rotation).transpose();
    let (table, sidecar) = (format!("{COLUMNS}\r\n{ROW}\r\n"), sidecar());
    for world in [DVec3::new(2.0, -1.5, 2.5), DVec3::new(1.5, 0.5, 3.25)] {
        let p = rotation * (world - DVec3::new(1.0, 2.0, 3.0));
        let (x, y) = (p.x / p.z, p.y / p.z);
        let r2 = x * x + y * y;
        let radial = 1.0 - 0.08 * r2 + 0.02 * r2.powi(2) - 0.01 * r2.powi(3) + 0.003 * r2.powi(4);
        let (t1, t2) = (0.004, -0.006);
        let bent_x = x * radial + t2 * 2.0 * x * y + t1 * (r2 + 2.0 * x * x);
        let bent_y = y * radial + t1 * 2.0 * x * y + t2 * (r2 + 2.0 * y * y);
        let expected = [focal * bent_x + 12.0 + 24.0 * 0.02, focal * bent_y + 8.0 - 24.0 * 0.01];
        for file in [("cams.csv", table.as_str()), ("images/a.xmp", sidecar.as_str())] {
            assert_projects(&[file], world.to_array(), expected);
        }
    }
}

fn sidecar() -> String {
    format!(
        "<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#'>\
         <rdf:Description xmlns:xcr='http://www.capturingreality.com/ns/xcr/1.1#' xcr:DistortionModel='brown4t2' \
         xcr:FocalLength35mm='30' xcr:Skew='0' xcr:AspectRatio='1' xcr:PrincipalPointU='0.02' xcr:PrincipalPointV='-0.01'>\
         <xcr:Rotation>{ROTATION}</xcr:Rotation><xcr:Position>1 2 3</xcr:Position>\
         <xcr:DistortionCoeficients>-0.08 0.02 -0.01 0.003 0.004 -0.006</xcr:DistortionCoeficients>\
         </rdf:Description></rdf:RDF></x:xmpmeta>"
    )
}

#[test]
fn points_may_lie_beside_cameras_under_any_name() {
    let header = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n";
    let (cloud, table) = (format!("{header}end_header\n1 2 9\n"), format!("{COLUMNS}\n{ROW}\n"));
    let points = |clouds: &[(&str, &str)]| {
        let folder = dataset(&[&[("cams.csv", table.as_str())], clouds].concat());
        let data = load(folder.path(), &alone()).unwrap();
        (data.points.positions.clone(), said(&data))
    };
    assert_eq!(points(&[("export.ply", &cloud)]), (vec![[1.0, 2.0, 9.0]], String::new()));
    let (none, said) = points(&[("export.ply", &cloud), ("other.ply", &cloud)]);
    assert!(none.is_empty() && said.contains("points are not used (2): export.ply, other.ply"), "{said}");
}

const OF_BROWN: &str = r#""projection_type": "brown", "focal_x": 0.8333333333333334, "focal_y": 0.7916666666666666, "c_x": 0.025,
    "c_y": -0.0125, "k1": -0.05, "k2": 0.01, "p1": 0.002, "p2": -0.003, "k3": 0.004"#;
const OF_FISHEYE: &str = r#""projection_type": "fisheye_opencv", "focal_x": 0.625, "focal_y": 0.6458333333333334,
    "c_x": -0.020833333333333332, "c_y": 0.016666666666666666, "k1": 0.03, "k2": -0.01, "k3": 0.002, "k4": 0.001"#;

fn opensfm(scene: &FixtureScene, camera: &str) -> String {
    let (mut shots, mut points) = (String::new(), String::new());
    for image in &scene.images {
        let (name, shift) = (&image.name[5..], image.pose.translation.to_array());
        let turn = DQuat::from_mat3(&image.pose.rotation).to_scaled_axis().to_array();
        write!(shots, r#", "{name}": {{"rotation": {turn:?}, "translation": {shift:?}, "camera": "c"}}"#).unwrap();
    }
    for (id, point) in scene.points.iter().enumerate() {
        let (rgb, place) = (point.rgb, point.position.to_array());
        write!(points, r#", "{id}": {{"color": {rgb:?}, "coordinates": {place:?}}}"#).unwrap();
    }
    let (shots, points) = (&shots[2..], &points[2..]);
    format!(
        r#"[{{"cameras": {{}}, "shots": {{"x": {{"rotation": [0, 0, 0], "translation": [0, 0, 0], "camera": "c"}}}}}},
        {{"cameras": {{"c": {{"width": 240, "height": 160, {camera}}}}}, "shots": {{{shots}}}, "points": {{{points}}}}}]"#
    )
}

#[test]
fn opensfm_has_the_largest_reconstruction_with_points_and_tracks() {
    let (folder, scene, expected) = scene(BROWN);
    let at = folder.path();
    std::fs::create_dir_all(at.join("opensfm/undistorted")).unwrap();
    write_png(&at.join("opensfm/undistorted/images/000.png.png"), 24, 16, [1; 3]);
    let path = at.join("opensfm/reconstruction.json");
    std::fs::write(&path, opensfm(&scene, OF_BROWN)).unwrap();
    let mut tracks = "OPENSFM_TRACKS_VERSION_v2\n".to_owned();
    for (id, point) in scene.points.iter().enumerate() {
        for image in scene.images.iter().filter(|image| point.track.contains(&image.id)) {
            writeln!(tracks, "{}\t{id}\t7\t0.1\t0.2\t1\t0\t0\t0", &image.name[5..]).unwrap();
        }
    }
    std::fs::write(at.join("opensfm/tracks.csv"), tracks).unwrap();
    for named in [at.to_owned(), at.join("opensfm"), path.clone()] {
        // sorted by keys, shots come behind points
        let sorted: serde_json::Value = serde_json::from_str(&opensfm(&scene, OF_BROWN)).unwrap();
        let padded = sorted.to_string().replacen("\"points\"", &format!("{}\"points\"", " ".repeat(1 << 16)), 2);
        std::fs::write(&path, padded).unwrap();
        let data = load(&named, &options()).unwrap();
        assert_eq!((data.format, &data.points), (Format::OpenSfm, &expected.points));
        assert_same(&data, &expected);
        assert_says(said(&data), &["photographs of 1 smaller reconstructions are left out (1): x"]);
    }
    let (folder, _, expected) = self::scene(FISHEYE);
    std::fs::write(folder.path().join("reconstruction.json"), opensfm(&scene, OF_FISHEYE)).unwrap();
    assert_same(&load(folder.path(), &options()).unwrap(), &expected);
}

#[test]
fn bundler_has_points_with_tracks_and_a_list_of_photographs() {
    let (folder, scene, expected) = scene(RADIAL);
    let at = folder.path();
    let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let mut bundle = format!("# Bundle file v0.3\n10 {}\n{}", scene.points.len(), "0 0 0\n".repeat(5));
    let mut list = "lost.jpg\n".to_owned();
    for image in &scene.images {
        let (rotation, translation) = (flip * image.pose.rotation, flip * image.pose.translation);
        writeln!(bundle, "21.0 -0.04 0.015\n{}\n{}", rows(rotation), words(translation)).unwrap();
        writeln!(list, "./prepare/{} 0 660.8", image.name).unwrap();
    }
    for point in &scene.points {
        let seen = scene.images.iter().zip(1..).filter(|(image, _)| point.track.contains(&image.id));
        let views: Vec<String> = seen.map(|(_, camera)| format!("{camera} 3 -1.5 2.5")).collect();
        let colour = point.rgb.map(|channel| channel.to_string()).join(" ");
        writeln!(bundle, "{}\n{colour}\n{} {}", words(point.position), views.len(), views.join(" ")).unwrap();
    }
    std::fs::create_dir(at.join("bundle")).unwrap();
    std::fs::write(at.join("bundle/bundle.out"), &bundle).unwrap();
    assert_refused(at, &options(), &["bundle.out", "the list of its photographs is not there", "10 cameras"]);
    std::fs::write(at.join("list.txt"), list).unwrap();
    let data = load(at, &options()).unwrap();
    assert_eq!((data.format, &data.points), (Format::Bundler, &expected.points));
    assert_same(&data, &expected);
    assert_eq!(said(&data).trim(), "Missing: cameras have no position, and are left out (1): lost.jpg");
    for (text, parts) in [
        (bundle.replace("v0.3", "v0.2"), &["the first line is `# Bundle file v0.2`"][..]),
        (bundle.replacen("21.0", "nan", 1), &["view `prepare/left/008.png`", "`fx` is NaN"]),
        (
            bundle.lines().take(20).collect::<Vec<_>>().join("\n"),
            &["a number of the camera of", "is `the end of the file`"],
        ),
        (bundle.replacen("8 3 -1.5", "88 3 -1.5", 1), &["a camera that sees point 0 is 88", "one of 10"]),
    ] {
        std::fs::write(at.join("bundle/bundle.out"), text).unwrap();
        assert_refused(at, &options(), &[&["bundle.out"], parts].concat());
    }
}

#[test]
fn a_model_of_colmap_comes_first_unless_another_file_is_named() {
    let (folder, scene, _) = scene(RADIAL);
    let at = folder.path();
    write_colmap(at, &scene, Encoding::Binary);
    let camera = |name: &str| format!("<camera sensor_id='0' label='{name}'>{IDENTITY}</camera>");
    let list: Vec<String> = scene.images.iter().map(|image| camera(&image.name)).collect();
    std::fs::write(at.join("doc.xml"), metashape(FRAME, &list.concat())).unwrap();
    std::fs::write(at.join("cams.csv"), format!("{COLUMNS}\n{ROW}\n")).unwrap();
    let data = load(at, &options()).unwrap();
    assert_eq!(data.format, Format::Colmap);
    assert_says(said(&data), &["cameras of Metashape are not used, for sparse/0/images.bin has others (1): doc.xml"]);
    let data = load(&at.join("doc.xml"), &options()).unwrap();
    assert_eq!(data.format, Format::Metashape);
    assert_says(said(&data), &["sparse/0 is not used, for doc.xml has", "cameras of RealityScan are not used"]);
    std::fs::remove_dir_all(at.join("sparse")).unwrap();
    assert_eq!(load(at, &options()).unwrap().format, Format::Metashape);
}

#[test]
fn panoramas_have_their_middle_ahead() {
    let sensor = "<sensor id='0' label='A' type='spherical'><resolution width='32' height='16'/></sensor>";
    let xml = metashape(sensor, &format!("<camera sensor_id='0' label='a.png'>{IDENTITY}</camera>"));
    let json = |kind: &str| {
        format!(
            r#"[{{"cameras": {{"c": {{"projection_type": "{kind}", "width": 32, "height": 16}}}},
            "shots": {{"a.png": {{"rotation": [0, 0, 0], "translation": [0, 0, 0], "camera": "c"}}}}}}]"#
        )
    };
    let files =
        [("c.xml", xml), ("reconstruction.json", json("spherical")), ("reconstruction.json", json("equirectangular"))];
    for (name, content) in files {
        let folder = dataset(&[(name, &content)]);
        write_png(&folder.path().join("images/a.png"), 32, 16, [9; 3]);
        let data = load(folder.path(), &alone()).unwrap();
        let names: Vec<&str> = data.train.iter().map(|view| view.name.as_str()).collect();
        assert_eq!(names, ["a_back.png", "a_down.png", "a_front.png", "a_left.png", "a_right.png", "a_up.png"]);
        let axes = [-DVec3::Z, DVec3::Y, DVec3::Z, -DVec3::X, DVec3::X, -DVec3::Y];
        for (view, axis) in data.train.iter().zip(axes) {
            let (x, y, depth) = view.camera.project(axis).unwrap();
            let middle = 0.5 * view.camera.width as f64;
            assert!((x - middle).abs() + (y - middle).abs() + (depth - 1.0).abs() < 1e-9, "{}", view.name);
        }
    }
}

#[test]
fn wrong_files_are_refused_by_name() {
    let xml = metashape(FRAME, &format!("<camera sensor_id='0' label='a'>{IDENTITY}</camera>"));
    let (csv, xmp) = (format!("{COLUMNS}\n{ROW}\n"), sidecar());
    let json = r#"[{"cameras": {"c": {"projection_type": "brown", "focal_x": 1, "focal_y": 1, "k1": 0.1}},
        "shots": {"a.png": {"rotation": [0, 0, 0], "translation": [0, 0, 0], "camera": "c"}}}]"#;
    for (file, content, parts) in [
        ("c.xml", xml[..xml.len() - 30].to_owned(), ["is not XML", ""]),
        ("c.xml", metashape(FRAME, "<camera label='a'/>"), ["none of its 1 cameras has a position", "align"]),
        ("c.xml", xml.replace("<f>19</f>", "<f>0</f>"), ["`f` of sensor `A` is 0", "focal length"]),
        ("c.xml", xml.replace("<cx>0.6", "<cx>nan"), ["`cx` of sensor `A` is `nan`", "a number"]),
        ("c.xml", xml.replace("1 0 0 0 0 1 0 0", "1 0 0 0 0 1 0"), ["the transform of camera `a`", "16 numbers"]),
        ("c.xml", xml.replace("1 0 0 0 0 1 0 0", "1 0 0 0 0 2 0 0"), ["the rotation of camera `a`", "without shear"]),
        ("c.xml", xml.replace("sensor_id='0'", "sensor_id='7'"), ["the sensor of camera `a` is `7`", "the id"]),
        ("c.xml", xml.replace("frame", "spherical"), ["view `a` is a panorama of 24x16 px", "twice as wide"]),
        (
            "c.xml",
            xml.replace("frame", "cylindrical"),
            ["camera model cylindrical of sensor `A`", "`spherical` are read"],
        ),
        ("c.xml", xml.replace("<b1>", "<b2>9</b2><b1>"), ["sensor `A`", "no rectangles"]),
        ("c.xml", xml.replace("<b1>", "<p3>0.001</p3><b1>"), ["sensor `A`", "p3 and p4 are not read"]),
        ("c.xml", xml.replace("label='a'", "label='b'"), ["images/b", "1 of 1 photographs"]),
        ("c.csv", csv.replace(",f,", ",focal,"), ["the header is without f", "Internal/External"]),
        ("c.csv", csv.replace(",0.02,", ",NaN,"), ["k2 in line 2 is `NaN`", "a number"]),
        ("c.csv", csv[..csv.len() - 20].to_owned(), ["line 2 is `a.png,1,2", "16 values"]),
        ("c.csv", csv.replace(",30,", ",0,"), ["view `a.png`", "`fx` is 0"]),
        ("a.xmp", xmp.replace("brown4t2", "division"), ["model division of photograph `a`", "lenses of Brown"]),
        ("a.xmp", xmp.replace("Ratio='1'", "Ratio='1.1'"), ["photograph `a`", "square pixels"]),
        ("a.xmp", xmp.replace("Position>", "Place>"), ["none of its 1 cameras", "align"]),
        ("r.json", json[..json.len() - 4].to_owned(), ["is not the JSON", "line 2"]),
        ("r.json", json.replace("brown", "spherical"), ["view `a.png` is a panorama of 24x16 px", "twice as wide"]),
        ("r.json", json.replace("brown", "dual"), ["camera model dual of camera `c`", "only perspective"]),
        ("r.json", json.replace("focal_y", "f"), ["view `a.png`", "`fy` is 0"]),
        ("r.json", json.replace("0.1", r#""0.1""#), ["view `a.png`", "`lens`"]),
        ("r.json", json.replace(r#"{"c""#, r#"{"d""#), ["the camera of shot `a.png` is `c`", "one of"]),
        ("r.json", r#"[{"cameras": {}, "shots": {}}]"#.to_owned(), ["none of its 0 cameras", "align"]),
    ] {
        let folder = dataset(&[(file, &content)]);
        assert_refused(folder.path(), &alone(), &[file, parts[0], parts[1]]);
    }
}
