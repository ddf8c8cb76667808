//! After training: the scale of a scene, and the removal of waste.

use super::{assert_contains, bytes, fails, folder, is_equal, json, json_of, ok, trained, words};

#[test]
fn a_known_length_is_stored_and_stays() {
    let at = &folder();
    trained(at, "run");
    std::fs::copy(at.join("run/scene.safetensors"), at.join("before.safetensors")).unwrap();
    let metres = |scene: &str| json_of(at, &["info", scene, "--json"])["metres_per_unit"].clone();
    assert!(metres("run").is_null());
    let scale = |args: &str| words(&format!("scale run {args}")).into_iter().map(str::to_owned).collect::<Vec<_>>();
    let refused = |args: &str| fails(at, 2, &scale(args).iter().map(String::as_str).collect::<Vec<_>>());
    for (args, part) in [
        ("--from 0,0,0 --to 0,0,1 --length 2", "a unit is missing"),
        ("--from 0,0,0 --to 0,0,1 --length -2m", "more than 0"),
        ("--from 0,0,0 --to 0,0,1 --length nanm", "more than 0"),
        ("--from 0,0 --to 0,0,1 --length 2m", "NAME@x,y"),
        ("--from 0,0,1 --to 0,0,1 --length 2m", "the same point"),
        ("--from train_01@1,1 --to 0,0,1 --length 2m --device cpu", "nearest names are train_0"),
        ("--from train_001@1,900 --to 0,0,1 --length 2m --device cpu", "160 x 160 px"),
    ] {
        assert_contains(&refused(args), &[part]);
    }
    assert!(is_equal(at.join("run/scene.safetensors"), at.join("before.safetensors")), "refused, and as it was");

    let table = ok(at, &words("scale run --from -1,0,0 --to 1,0,0 --length 50cm"));
    assert_contains(&table, &["2.000 world units are 50.00 cm", "1 world unit is 25.00 cm"]);
    assert_eq!(metres("run"), 0.25);
    ok(at, &words("compress run --out small.safetensors --device cpu"));
    ok(at, &words("scale small.safetensors --from 0,0,0 --to 0,0,1 --length 1ft"));
    assert_eq!(metres("small.safetensors"), 0.3048);
    let table = ok(at, &words("export run --format glb --out a.glb --fit 0 --device cpu"));
    assert_contains(&table, &["metres"]);
    assert_eq!(metres("a.glb"), 0.25, "it is read in world units");
    assert_contains(&fails(at, 2, &words("scale a.glb --from 0,0,0 --to 0,0,1 --length 1m")), &["a.glb", "splats"]);

    // a run that goes on keeps it
    ok(at, &words("train --out run --resume --steps 61 --device cpu"));
    assert_eq!(metres("run"), 0.25);
    assert!(!is_equal(at.join("run/scene.safetensors"), at.join("before.safetensors")));
}

#[test]
fn waste_is_removed_and_its_price_is_printed() {
    let at = &folder();
    trained(at, "run");
    let counted = ok(at, &words("clean run --dry-run --box -1,-1,-1,1,1,1 --json counted.json --device cpu"));
    assert_contains(&counted, &["outside", "unseen", "left"]);
    assert!(!counted.contains("floaters"), "they are asked for: {counted}");
    let asked = ok(at, &words("clean run --dry-run --floaters --device cpu"));
    assert_contains(&asked, &["floaters", "unseen", "left"]);
    assert_eq!(std::fs::read_dir(at).unwrap().filter(|entry| is_new(entry.as_ref().unwrap())).count(), 0);
    assert_contains(&fails(at, 2, &words("clean run --out clean.ply --device cpu")), &["clean.ply", "dpges export"]);
    let table = ok(at, &words("clean run --box -1,-1,-1,1,1,1 --out clean.safetensors --json clean.json --device cpu"));
    assert_contains(&table, &["6 views, split `test`", "clean_before.png", "clean_after.png"]);
    let [counted, cleaned] = ["counted.json", "clean.json"].map(|name| json(at.join(name)));
    assert_eq!(counted["removed"], cleaned["removed"]);
    let info = json_of(at, &["info", "clean.safetensors", "--json"]);
    for kind in ["surfels", "gaussians"] {
        assert_eq!(info[kind], cleaned[kind]);
        let removed: u64 = cleaned["removed"].as_array().unwrap().iter().map(|rule| rule[kind].as_u64().unwrap()).sum();
        assert_eq!(removed + cleaned[kind].as_u64().unwrap(), cleaned[format!("{kind}_before")].as_u64().unwrap());
    }
    assert!(bytes(at.join("clean_before.png")) != bytes(at.join("clean_after.png")));

    std::fs::copy(at.join("run/scene.safetensors"), at.join("alone.safetensors")).unwrap();
    let table = ok(at, &words("clean alone.safetensors --largest 100 --out same.safetensors"));
    assert_contains(&table, &["oversized", "0 surfels, 0 Gaussians", "unseen", "not looked for", "--data"]);
    assert!(is_equal(at.join("alone.safetensors"), at.join("same.safetensors")));
    for (args, part) in [
        ("", "--out"),
        ("--out no", "--data"),
        ("--out no --largest 1 --floaters", "--data"),
        ("--out no --largest 1 --consolidate 50%", "--data"),
        ("--out no --consolidate 0%", "such as 50%"),
        ("--out no --box 0,0,0,1,1", "no box"),
        ("--out no --largest 0", "no size"),
        ("--out alone.safetensors --largest 1", "--out is the scene itself"),
    ] {
        let message = fails(at, 2, &words(format!("clean alone.safetensors {args}").trim()));
        assert_contains(&message, &[part]);
    }
    let message = fails(at, 1, &words("clean alone.safetensors --box 90,90,90,91,91,91 --out no"));
    assert_contains(&message, &["nothing would be left"]);
    assert!(!at.join("no").exists());
}

/// Whether an entry is a scene or a picture that a command wrote.
fn is_new(entry: &std::fs::DirEntry) -> bool {
    entry.path().extension().is_some_and(|ending| ending == "safetensors" || ending == "png")
}
