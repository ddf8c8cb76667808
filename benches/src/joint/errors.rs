//! Squared errors of 8-bit pictures, over all pixels that count and by kind of pixel.

use super::pixels::PixelKind;

/// PSNR of what is equal, dB, as evaluations have it.
pub use dpges_train::eval::LARGEST_PSNR;

/// Pixels and their errors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorSum {
    pub pixels: usize,
    /// Sum over pixels and channels, of values from 0 to 1.
    pub squared: f64,
}

impl ErrorSum {
    fn add(&mut self, squared: f64) {
        self.pixels += 1;
        self.squared += squared;
    }

    /// dB; `None` without pixels.
    pub fn psnr(self) -> Option<f64> {
        let mean = self.squared / (3 * self.pixels) as f64;
        (self.pixels > 0).then(|| (-10.0 * mean.log10()).min(LARGEST_PSNR))
    }
}

/// Squared errors of some views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Errors {
    /// PSNR of each view, dB.
    pub views: Vec<f64>,
    /// In the order of [`PixelKind::ALL`], over all views.
    by_kind: [ErrorSum; 4],
}

impl Errors {
    /// Adds a view: what was `drawn` and its `photograph`, [H, W, 3] bytes, the pixels of the photograph that count
    /// (all if there is no mask), and the `kinds` of pixels.
    ///
    /// # Panics
    /// If these are not of one size.
    pub fn add(&mut self, drawn: &[u8], photograph: &[u8], counted: Option<&[bool]>, kinds: &[PixelKind]) {
        assert_eq!((drawn.len(), photograph.len()), (3 * kinds.len(), 3 * kinds.len()), "pictures of one size");
        let mut all = ErrorSum::default();
        for (pixel, kind) in kinds.iter().enumerate() {
            if counted.is_some_and(|counted| !counted[pixel]) {
                continue;
            }
            let square = |at: usize| (f64::from(drawn[at]) - f64::from(photograph[at])).powi(2) / (255.0 * 255.0);
            let squared = (3 * pixel..3 * pixel + 3).map(square).sum();
            all.add(squared);
            self.by_kind[index(*kind)].add(squared);
        }
        self.views.extend(all.psnr());
    }

    /// Mean PSNR of the views, dB.
    pub fn psnr(&self) -> f64 {
        self.views.iter().sum::<f64>() / self.views.len() as f64
    }

    pub fn of(&self, kind: PixelKind) -> ErrorSum {
        self.by_kind[index(kind)]
    }

    /// Share of the pixels of all views, %.
    pub fn share(&self, kind: PixelKind) -> f64 {
        let pixels: usize = self.by_kind.iter().map(|sum| sum.pixels).sum();
        100.0 * self.of(kind).pixels as f64 / pixels.max(1) as f64
    }
}

fn index(kind: PixelKind) -> usize {
    PixelKind::ALL.iter().position(|&other| other == kind).expect("all kinds are listed")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_belong_to_the_view_and_to_the_kind_of_their_pixel() {
        let kinds = [PixelKind::Inside, PixelKind::Rim, PixelKind::Inside, PixelKind::Uncovered];
        let photograph = [100; 12];
        let mut drawn = photograph;
        // a tenth in one channel of the rim, and something where nothing counts
        (drawn[4], drawn[9]) = (125, 255);
        let mut errors = Errors::default();
        errors.add(&drawn, &photograph, Some(&[true, true, true, false]), &kinds);
        errors.add(&photograph, &photograph, None, &kinds);
        let squared = (25.0_f64 / 255.0).powi(2);
        assert!((errors.of(PixelKind::Rim).squared - squared).abs() < 1e-12);
        assert!((errors.of(PixelKind::Rim).psnr().unwrap() + 10.0 * (squared / 6.0).log10()).abs() < 1e-9);
        assert_eq!(errors.of(PixelKind::Inside), ErrorSum { pixels: 4, squared: 0.0 });
        assert_eq!(errors.of(PixelKind::Uncovered).pixels, 1);
        assert_eq!((errors.of(PixelKind::Silhouette).psnr(), errors.share(PixelKind::Silhouette)), (None, 0.0));
        assert!((errors.share(PixelKind::Inside) - 100.0 * 4.0 / 7.0).abs() < 1e-9);
        let first = -10.0 * (squared / 9.0).log10();
        assert!((errors.psnr() - 0.5 * (first + LARGEST_PSNR)).abs() < 1e-9);
    }
}
