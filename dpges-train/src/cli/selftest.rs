//! `dpges selftest`: whether a device computes what the specification of the model says.

use std::collections::HashMap;
use std::time::Instant;

use burn::tensor::{DType, Device};
use clap::Args;
use dpges_core::testing;
use dpges_core::testing::golden::{Deviation, GoldenCase};
use dpges_train::device::DeviceName;
use serde::Serialize;

use super::device_failure::Watch;
use super::{Failure, Result, print, table};

/// Scenes with the pictures, losses and gradients that the float64 specification computes of them: a plain one, one
/// with more surfels to a pixel than are peeled, one with the camera among the primitives, one that can be seen
/// through.
const CASES: [(&str, &[u8]); 4] = [
    ("basic", include_bytes!("../../../tests/golden/basic.safetensors")),
    ("crowded", include_bytes!("../../../tests/golden/crowded.safetensors")),
    ("inside", include_bytes!("../../../tests/golden/inside.safetensors")),
    ("four_layers_translucent", include_bytes!("../../../tests/golden/four_layers_translucent.safetensors")),
];

/// Beside what rounding the inputs to f32 causes.
const TOLERANCE: f64 = 2e-4;

/// Operations, and how the names of the tensors begin that come from each; a tensor belongs to the first that fits.
const OPERATIONS: [(&str, &str); 12] = [
    ("peel: ids, pixels", "out.layers.ids"),
    ("peel", "out.layers."),
    ("splat", "out.gaussian_"),
    ("composite", "out."),
    ("SSIM", "loss.ssim"),
    ("losses", "loss."),
    ("backward from the picture: surfels", "grad_image.surfels."),
    ("backward from the picture: Gaussians", "grad_image.gaussians."),
    ("the same, transmittance detached: surfels", "grad_detached.surfels."),
    ("the same, transmittance detached: Gaussians", "grad_detached.gaussians."),
    ("backward from the losses: surfels", "grad_total.surfels."),
    ("backward from the losses: Gaussians", "grad_total.gaussians."),
];

/// Check that a device computes what it should
///
/// Renders small scenes on the device in f32 and compares pictures, losses and gradients with those of the model's
/// float64 specification, which are part of the program. Ends with 1 if any is too far off.
#[derive(Debug, Args)]
pub struct SelftestArgs {
    /// cpu, cpu-flex, wgpu (the best GPU), or what else `dpges devices` lists
    #[arg(long, value_name = "NAME", default_value = "wgpu")]
    device: DeviceName,
    /// As JSON
    #[arg(long)]
    json: bool,
}

/// How far one tensor of one case is from what it should be.
#[derive(Clone, Debug, Serialize)]
struct Finding {
    operation: &'static str,
    case: &'static str,
    tensor: String,
    /// Relative L2 distance; of ids the number of pixels where they differ.
    error: f64,
    tolerance: f64,
    passed: bool,
}

#[derive(Serialize)]
struct Report {
    device: String,
    /// What the device is on this machine.
    description: String,
    passed: bool,
    tensors: usize,
    seconds: f64,
    /// The worst tensor of each.
    operations: Vec<Finding>,
}

pub fn run(args: &SelftestArgs) -> Result<()> {
    let device = args.device.open()?;
    let description = args.device.describe()?;
    let start = Instant::now();
    let findings = Watch::start()
        .catch(|| CASES.iter().flat_map(|&(case, bytes)| check(case, bytes, &device)).collect::<Vec<_>>())
        .map_err(|failure| Failure::with_help(format!("{description} failed: {failure}"), advice(args.device)))?;
    let report = Report {
        device: args.device.to_string(),
        passed: findings.iter().all(|finding| finding.passed),
        tensors: findings.len(),
        seconds: start.elapsed().as_secs_f64(),
        operations: worst(&findings),
        description,
    };
    let text = if args.json { format!("{}\n", serde_json::to_string_pretty(&report)?) } else { summary(&report) };
    print(&text)?;
    if report.passed {
        return Ok(());
    }
    let wrong = findings.iter().filter(|finding| !finding.passed).count();
    let message = format!("{} computes {wrong} of {} tensors wrongly", report.description, report.tensors);
    Err(Failure::with_help(message, advice(args.device)))
}

fn advice(device: DeviceName) -> &'static str {
    if device.is_cpu() {
        "this is a fault of the program or of this build: please report it with the table above"
    } else {
        "do not train on it: update its driver, or try another --device (`dpges devices`; `cpu` works everywhere); \
         please report it with what `dpges devices` says"
    }
}

fn load(case: &str, bytes: &[u8]) -> GoldenCase {
    GoldenCase::from_bytes(case, bytes).expect("the built-in cases are whole")
}

/// Every tensor of a case.
fn check(case: &'static str, bytes: &[u8], device: &Device) -> Vec<Finding> {
    judge(case, load(case, bytes).compare(device, DType::F32), &rounding(case, bytes))
}

/// What rounding the inputs to f32 does to each tensor, if everything else is exact.
fn rounding(case: &str, bytes: &[u8]) -> HashMap<String, f64> {
    let rounded = load(case, bytes).rounded_to_f32().compare(&testing::device(), DType::F64);
    rounded.into_iter().map(|deviation| (deviation.tensor, deviation.distance)).collect()
}

fn judge(case: &'static str, deviations: Vec<Deviation>, rounding: &HashMap<String, f64>) -> Vec<Finding> {
    let finding = |Deviation { tensor, distance, is_id }| {
        let operation = OPERATIONS.iter().find(|(_, start)| tensor.starts_with(start));
        let &(operation, _) = operation.expect("every tensor of a case belongs to an operation");
        let tolerance = rounding[&tensor] + if is_id { 0.0 } else { TOLERANCE };
        Finding { operation, case, tensor, error: distance, tolerance, passed: distance <= tolerance }
    };
    deviations.into_iter().map(finding).collect()
}

/// Of each operation, one that failed before one that passed, and the largest error.
fn worst(findings: &[Finding]) -> Vec<Finding> {
    let badness = |a: &&Finding, b: &&Finding| b.passed.cmp(&a.passed).then(a.error.total_cmp(&b.error));
    let worst_of = |&(operation, _): &(&str, &str)| {
        findings.iter().filter(|finding| finding.operation == operation).max_by(badness).cloned()
    };
    OPERATIONS.iter().filter_map(worst_of).collect()
}

fn summary(report: &Report) -> String {
    let mut rows = vec![("operation", "worst error, tolerance, where".to_owned())];
    for Finding { operation, case, tensor, error, tolerance, passed } in &report.operations {
        let verdict = if *passed { "ok" } else { "WRONG" };
        let (error, tolerance) = (number(*error), number(*tolerance));
        rows.push((*operation, format!("{error:>7} {tolerance:>7}  {verdict:5}  {case}: {tensor}")));
    }
    rows.push(("device", report.description.clone()));
    let verdict = if report.passed { "all as they should be" } else { "NOT all as they should be" };
    rows.push(("result", format!("{} tensors in {:.1} s, {verdict}", report.tensors, report.seconds)));
    table(&rows)
}

fn number(value: f64) -> String {
    if value.fract() == 0.0 { format!("{value}") } else { format!("{value:.1e}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_operation_is_checked_and_a_wrong_tensor_is_found() {
        let (case, bytes) = CASES[0];
        let findings = check(case, bytes, &testing::device());
        assert_eq!(worst(&findings).len(), OPERATIONS.len());
        assert!(findings.iter().all(|finding| finding.passed), "{:?}", worst(&findings));

        let wrong = "grad_total.gaussians.opacities";
        let perturbed = load(case, bytes).perturbed(wrong, 1.01).compare(&testing::device(), DType::F32);
        let findings = judge(case, perturbed, &rounding(case, bytes));
        let failed: Vec<&str> = findings.iter().filter(|f| !f.passed).map(|f| f.tensor.as_str()).collect();
        assert_eq!(failed, [wrong]);
        let of_operation = worst(&findings).pop().unwrap();
        assert_eq!((of_operation.tensor.as_str(), of_operation.passed), (wrong, false));
    }
}
