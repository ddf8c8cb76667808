//! Golden cases on a device: whether it computes what the specification of the model says.

use std::collections::HashMap;

use burn::tensor::{DType, Device};
use dpges_core::testing;
use dpges_core::testing::golden::{Deviation, GoldenCase};
use serde::Serialize;

/// A small scene with the pictures, losses and gradients that the float64 specification computes for it.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    pub name: &'static str,
    bytes: &'static [u8],
}

/// A plain scene; one with more rims per pixel than are peeled; one with the camera among the primitives; one of
/// translucent surfels. The first is the quickest.
pub const CASES: [Case; 5] = [
    Case { name: "basic", bytes: include_bytes!("../../golden/basic.safetensors") },
    Case { name: "crowded_rims", bytes: include_bytes!("../../golden/crowded_rims.safetensors") },
    Case { name: "crowded", bytes: include_bytes!("../../golden/crowded.safetensors") },
    Case { name: "inside", bytes: include_bytes!("../../golden/inside.safetensors") },
    Case { name: "four_layers_translucent", bytes: include_bytes!("../../golden/four_layers_translucent.safetensors") },
];

/// Relative error that is tolerated in addition to the effect of rounding the inputs to f32.
const TOLERANCE: f64 = 2e-4;

/// Operations, each with the prefix of the names of its tensors. A tensor belongs to the first prefix that fits.
pub const OPERATIONS: [(&str, &str); 12] = [
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

/// The error of one tensor of one case.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    pub operation: &'static str,
    pub case: &'static str,
    pub tensor: String,
    /// Relative L2 distance. For ids: the number of pixels that differ.
    pub error: f64,
    pub tolerance: f64,
    pub passed: bool,
}

impl Case {
    fn load(self) -> GoldenCase {
        GoldenCase::from_bytes(self.name, self.bytes).expect("the built-in cases are whole")
    }

    /// Renders the case on `device` in f32, differentiates it, and compares every tensor with its golden values.
    pub fn check(self, device: &Device) -> Vec<Finding> {
        self.judge(self.load().compare(device, DType::F32), &self.rounding())
    }

    /// The effect on each tensor of rounding the inputs to f32, with exact computation.
    fn rounding(self) -> HashMap<String, f64> {
        let rounded = self.load().rounded_to_f32().compare(&testing::device(), DType::F64);
        rounded.into_iter().map(|deviation| (deviation.tensor, deviation.distance)).collect()
    }

    fn judge(self, deviations: Vec<Deviation>, rounding: &HashMap<String, f64>) -> Vec<Finding> {
        let finding = |Deviation { tensor, distance, is_id }| {
            let operation = OPERATIONS.iter().find(|(_, prefix)| tensor.starts_with(prefix));
            let &(operation, _) = operation.expect("every tensor of a case belongs to an operation");
            let tolerance = rounding[&tensor] + if is_id { 0.0 } else { TOLERANCE };
            Finding { operation, case: self.name, tensor, error: distance, tolerance, passed: distance <= tolerance }
        };
        deviations.into_iter().map(finding).collect()
    }
}

/// The worst finding of each operation: failures before passes, then by error.
pub fn worst(findings: &[Finding]) -> Vec<Finding> {
    let badness = |a: &&Finding, b: &&Finding| b.passed.cmp(&a.passed).then(a.error.total_cmp(&b.error));
    let worst_of = |&(operation, _): &(&str, &str)| {
        findings.iter().filter(|finding| finding.operation == operation).max_by(badness).cloned()
    };
    OPERATIONS.iter().filter_map(worst_of).collect()
}

/// The errors of a device, operation by operation.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    pub device: String,
    /// The device on this machine.
    pub description: String,
    pub passed: bool,
    pub tensors: usize,
    pub seconds: f64,
    /// The worst tensor of each.
    pub operations: Vec<Finding>,
    /// Number of tensors that are wrong.
    #[serde(skip)]
    pub wrong: usize,
}

impl Report {
    /// Summarises the `findings` of the device that is called so, which took `seconds`.
    pub fn new(device: String, description: String, findings: &[Finding], seconds: f64) -> Self {
        let wrong = findings.iter().filter(|finding| !finding.passed).count();
        let (tensors, operations) = (findings.len(), worst(findings));
        Self { device, description, passed: wrong == 0, tensors, seconds, operations, wrong }
    }

    /// For people.
    pub fn rows(&self) -> Vec<(&str, String)> {
        let number = |value: f64| if value.fract() == 0.0 { format!("{value}") } else { format!("{value:.1e}") };
        let mut rows = vec![("operation", "worst error, tolerance, where".to_owned())];
        for Finding { operation, case, tensor, error, tolerance, passed } in &self.operations {
            let verdict = if *passed { "ok" } else { "WRONG" };
            let (error, tolerance) = (number(*error), number(*tolerance));
            rows.push((*operation, format!("{error:>7} {tolerance:>7}  {verdict:5}  {case}: {tensor}")));
        }
        rows.push(("device", self.description.clone()));
        let verdict = if self.passed { "all as they should be" } else { "NOT all as they should be" };
        rows.push(("result", format!("{} tensors in {:.1} s, {verdict}", self.tensors, self.seconds)));
        rows
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_operation_is_checked_and_a_wrong_tensor_is_found() {
        let case = CASES[0];
        let findings = case.check(&testing::device());
        assert_eq!(worst(&findings).len(), OPERATIONS.len());
        assert!(findings.iter().all(|finding| finding.passed), "{:?}", worst(&findings));

        let wrong = "grad_total.gaussians.opacities";
        let perturbed = case.load().perturbed(wrong, 1.01).compare(&testing::device(), DType::F32);
        let findings = case.judge(perturbed, &case.rounding());
        let failed: Vec<&str> = findings.iter().filter(|f| !f.passed).map(|f| f.tensor.as_str()).collect();
        assert_eq!(failed, [wrong]);
        let of_operation = worst(&findings).pop().unwrap();
        assert_eq!((of_operation.tensor.as_str(), of_operation.passed), (wrong, false));
    }
}
