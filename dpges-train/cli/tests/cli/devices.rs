//! Which device is used, and whether it computes what it should.

use serde_json::Value;

use super::{assert_contains, folder, json, json_of, ok, said};

#[test]
fn the_first_line_says_which_device_and_why() {
    let at = &folder();
    let first_line = |args: &[&str]| said(at, args).lines().next().unwrap().to_owned();
    let short = ["train", "--out=run", "--steps=2", "--max-resolution=24", "--set=init.max_points=100"];
    let trained = first_line(&short);
    let chosen = ok(at, &["devices", "--auto"]);
    let device = chosen.split(',').next().unwrap();
    assert!(trained.contains(&format!("device: {device}, since ")), "{trained}, but {chosen}");
    if device == "cpu" {
        assert!(["no GPU", "no hardware GPU"].iter().any(|part| chosen.contains(part)), "{chosen}");
    } else {
        assert!(device.starts_with("wgpu:") && chosen.contains("passed a check"), "{chosen}");
    }
    assert_eq!(json(at.join("run/run.json"))["device"], device, "a name, not `auto`");

    let again = first_line(&["train", "--out=run", "--resume"]);
    assert!(again.contains(&format!("device: {device} (")) && again.contains("as before"), "{again}");
    assert!(first_line(&["train", "--out=run", "--resume", "--device=auto"]).contains(", since "));
    assert!(first_line(&["eval", "run"]).contains(&format!("device: {device}, since ")));
    let named = first_line(&["render", "run", "--out=pictures", "--device=cpu-ndarray"]);
    assert!(named.contains("device: cpu-ndarray (burn-ndarray on the CPU), as --device says"), "{named}");
    let study = ["ablate", "--out=study", "--only=full", "--steps=2", "--max-resolution=24", "--device=auto"];
    assert!(first_line(&study).contains(&format!("device: {device}, since ")));
    assert_eq!(json_of(at, &["devices", "--auto", "--json"])["device"], device);
}

#[test]
fn devices_are_listed_with_what_device_takes() {
    let at = &folder();
    let table = ok(at, &["devices"]);
    assert_contains(&table, &["cpu-ndarray", "burn-flex", "wgpu"]);
    let list = json_of(at, &["devices", "--json"]);
    assert_eq!(list["cpus"][0]["device"], "cpu");
    let adapters = list["adapters"].as_array().unwrap();
    assert_eq!(adapters.is_empty(), list["advice"].is_string(), "{list}");
    for (number, adapter) in adapters.iter().enumerate() {
        assert_eq!(adapter["device"], format!("wgpu:{number}"));
        assert_eq!(adapter["suitable"], Value::from(adapter["shortcoming"].is_null()));
        for key in ["name", "kind", "api", "driver", "storage_binding_bytes", "f32_atomic_add"] {
            assert!(!adapter[key].is_null(), "{key}: {adapter}");
        }
    }
    let has_gpu = adapters.iter().any(|adapter| adapter["suitable"] == true);
    assert!(has_gpu || std::env::var_os("DPGES_REQUIRE_GPU").is_none(), "{list}");
}

#[test]
fn the_cpus_pass_the_selftest() {
    let at = &folder();
    let table = ok(at, &["selftest", "--device", "cpu"]);
    let parts = ["peel", "splat", "composite", "SSIM", "backward", "burn-flex", "all as they should be"];
    assert_contains(&table, &parts);
    assert!(!table.contains("WRONG"), "{table}");
    let report = json_of(at, &["selftest", "--device", "cpu-ndarray", "--json"]);
    assert_eq!((&report["passed"], &report["device"]), (&Value::from(true), &Value::from("cpu-ndarray")));
    assert!(report["tensors"].as_u64().unwrap() > 150, "{report}");
}
