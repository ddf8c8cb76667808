use super::super::cloud::tests::sample;
use super::*;

/// A cloud in the order of its file, and what is read of that.
fn written(mut cloud: SplatCloud) -> (SplatCloud, SplatCloud) {
    cloud = cloud.select(&along_morton_curve(cloud.positions.as_flattened()));
    let read = read(&to_sog(&cloud).unwrap()).unwrap().0;
    assert_eq!((read.len(), read.degree, &read.info), (cloud.len(), cloud.degree, &cloud.info));
    (cloud, read)
}

fn farthest<'a>(found: impl IntoIterator<Item = &'a f32>, expected: impl IntoIterator<Item = &'a f32>) -> f32 {
    found.into_iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn splats_come_back_within_their_steps() {
    for degree in 0..=3 {
        let (cloud, read) = written(sample(300, degree));
        // positions within ±3: half a step of 2 ln 4 / 65,535, as long as 4 at the rim
        let positions = farthest(read.positions.as_flattened(), cloud.positions.as_flattened());
        assert!(positions < 1.01 * 4.0 * 4f32.ln() / 65_535.0, "{positions}");
        // 900 numbers over 3 in a codebook of 256
        assert!(farthest(read.log_scales.as_flattened(), cloud.log_scales.as_flattened()) < 0.01);
        assert!(farthest(&read.opacities, &cloud.opacities) < 0.501 / 255.0);
        for (found, expected) in read.quaternions.iter().zip(&cloud.quaternions) {
            let dot: f32 = found.iter().zip(expected).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 0.9999, "{found:?} {expected:?}");
        }
        let bases = |cloud: &SplatCloud| (0..300).flat_map(|row| cloud.harmonics_of(row)[0]).collect::<Vec<_>>();
        assert!(farthest(&bases(&read), &bases(&cloud)) < 0.005);
        // 300 splats share 256 entries of numbers up to 0.6
        let squares = read.harmonics.iter().zip(&cloud.harmonics).map(|(a, b)| f64::from((a - b) * (a - b)));
        let rms = (squares.sum::<f64>() / read.harmonics.len() as f64).sqrt();
        assert!(rms < 0.003, "degree {degree}: {rms}");
    }
}

#[test]
fn files_in_a_folder_are_read_as_those_of_an_archive() {
    let (cloud, bundled) = written(sample(30, 1));
    let folder = tempfile::tempdir().unwrap();
    let files = files(&cloud);
    files.iter().for_each(|(name, bytes)| std::fs::write(folder.path().join(name), bytes).unwrap());
    let meta = &files.iter().find(|(name, _)| name == META).unwrap().1;
    assert!(is_meta(meta) && !is_meta(b"{\"asset\": {}, \"scenes\": []}"));
    let (read, _) = read_unbundled(meta, folder.path()).unwrap();
    assert_eq!((read.positions, read.harmonics), (bundled.positions, bundled.harmonics));
    let elsewhere = String::from_utf8(meta.clone()).unwrap().replace("quats.webp", "../quats.webp");
    assert!(read_unbundled(elsewhere.as_bytes(), folder.path()).unwrap_err().contains("`../quats.webp` is no name"));
    std::fs::remove_file(folder.path().join("sh0.webp")).unwrap();
    assert!(read_unbundled(meta, folder.path()).unwrap_err().contains("sh0.webp"));
}

#[test]
fn pixels_and_the_document_are_those_of_the_format() {
    let mut cloud = sample(3, 1);
    cloud.positions = vec![[0.0, 0.0, 5.0], [1.0, -2.0, 5.0], [3.0, 0.5, 5.0]];
    cloud.quaternions[1] = [-0.8, 0.6, 0.0, 0.0];
    let files = files(&cloud);
    let file = |name: &str| &files.iter().find(|(found, _)| found == name).unwrap().1;
    let meta: serde_json::Value = serde_json::from_slice(file(META)).unwrap();
    assert_eq!((&meta["version"], &meta["count"], &meta["model"]), (&2.into(), &3.into(), &"antialiased".into()));
    assert_eq!((&meta["shN"]["bands"], &meta["shN"]["count"]), (&1.into(), &2.into()));
    let bounds = [&meta["means"]["mins"][1], &meta["means"]["maxs"][0]].map(|bound| bound.as_f64().unwrap());
    assert!((bounds[0] + 3f64.ln()).abs() < 1e-12 && (bounds[1] - 4f64.ln()).abs() < 1e-12, "{bounds:?}");
    assert_eq!(meta["scales"]["codebook"].as_array().unwrap().len(), 256);
    let pixels = |name: &str| Pixels::from_webp(file(name), name).unwrap();
    // ln 2 / ln 4 is half way; all have the same z
    let [low, high] = ["means_l.webp", "means_u.webp"].map(|name| pixels(name).take(3, name).unwrap());
    assert_eq!((low[1], high[1]), ([0, 0, 0, 255], [128, 0, 0, 255]));
    assert_eq!((low[2][0], high[2][0]), (255, 255));
    // −0.6 × √2 of a half, and 0, which lies between two steps
    assert_eq!(pixels("quats.webp").take(2, "").unwrap()[1], [19, 128, 128, 252]);
    let [width, rows] = [pixels("sh0.webp").width, pixels("shN_centroids.webp").width];
    assert_eq!((width, rows), (4, 64 * 3));
    assert_eq!(pixels("sh0.webp").take(1, "").unwrap()[0][3], to_byte(cloud.opacities[0]));
    cloud.degree = 0;
    cloud.harmonics.truncate(9);
    assert!(super::files(&cloud).iter().all(|(name, _)| !name.starts_with("shN")));
}

#[test]
fn files_of_others_say_their_filter_and_broken_ones_what_is_wrong() {
    let files = files(&sample(70, 2));
    let changed = |change: &dyn Fn(&mut serde_json::Value)| {
        let mut files = files.clone();
        let meta = files.last_mut().unwrap();
        let mut document = serde_json::from_slice(&meta.1).unwrap();
        change(&mut document);
        meta.1 = serde_json::to_vec(&document).unwrap();
        read(&stored(files.iter().map(|(name, bytes)| (&**name, &**bytes))))
    };
    let foreign = |meta: &mut serde_json::Value| {
        meta.as_object_mut().unwrap().retain(|key, _| !["asset", "model", "antialias"].contains(&&**key));
    };
    let (cloud, notes) = changed(&foreign).unwrap();
    assert!(!notes.own && cloud.info.screen_filter == ScreenFilter::Plain && cloud.degree == 2);
    let wrong = |key: &str, value: serde_json::Value| {
        let pointer = format!("/{key}");
        changed(&|meta| *meta.pointer_mut(&pointer).unwrap() = value.clone()).err().unwrap()
    };
    for (key, value, expected) in [
        ("version", 3.into(), "version 3, expected 2"),
        ("count", 1000.into(), "`means_l.webp` has 96 pixels, expected 1000"),
        ("means/files/1", "none.webp".into(), "`none.webp`"),
        ("means/files/1", META.into(), "cannot be read as WebP"),
        ("scales/codebook", serde_json::json!([1.0]), "of a codebook of 1 is asked for"),
        ("shN/bands", 4.into(), "degree 4"),
        ("shN/bands", 1.into(), "512 pixels wide, expected 192"),
        ("shN/count", 2.into(), "of a palette of 2 is asked for"),
        ("quats", 7.into(), "version 2 ("),
    ] {
        let found = wrong(key, value);
        assert!(found.contains(expected), "{key}: {found}");
    }
    let other = read(&stored([("scene.usda", &b"#usda 1.0"[..])])).unwrap_err();
    assert!(other.contains("only bundled SOG"), "{other}");
}
