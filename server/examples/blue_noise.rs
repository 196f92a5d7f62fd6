//! Makes the blue noise of the temporal window: three masks of 64 × 64 by void and cluster (R. Ulichney, "The
//! void-and-cluster method for dither array generation", 1993). Argument: the PNG to write.

const SIZE: usize = 64;
const PIXELS: usize = SIZE * SIZE;
/// Width of the filter, pixels. Ulichney's choice.
const SIGMA: f64 = 1.5;

struct Pattern {
    set: Vec<bool>,
    energy: Vec<f64>,
    kernel: Vec<f64>,
}

impl Pattern {
    fn new() -> Self {
        let along = |d: usize| d.min(SIZE - d) as f64;
        let kernel = (0..PIXELS)
            .map(|at| {
                let (x, y) = (along(at % SIZE), along(at / SIZE));
                (-(x * x + y * y) / (2.0 * SIGMA * SIGMA)).exp()
            })
            .collect();
        Self {
            set: vec![false; PIXELS],
            energy: vec![0.0; PIXELS],
            kernel,
        }
    }

    fn put(&mut self, at: usize, set: bool) {
        self.set[at] = set;
        let sign = if set { 1.0 } else { -1.0 };
        for other in 0..PIXELS {
            let dx = (other % SIZE + SIZE - at % SIZE) % SIZE;
            let dy = (other / SIZE + SIZE - at / SIZE) % SIZE;
            self.energy[other] += sign * self.kernel[dy * SIZE + dx];
        }
    }

    /// The set pixel with most set pixels around it.
    fn cluster(&self) -> usize {
        let set = (0..PIXELS).filter(|at| self.set[*at]);
        set.max_by(|a, b| self.energy[*a].total_cmp(&self.energy[*b]))
            .unwrap_or(0)
    }

    /// The pixel with least around it that is not set.
    fn void(&self) -> usize {
        let empty = (0..PIXELS).filter(|at| !self.set[*at]);
        empty
            .min_by(|a, b| self.energy[*a].total_cmp(&self.energy[*b]))
            .unwrap_or(0)
    }
}

/// The rank of every pixel.
fn void_and_cluster(seed: u64) -> Vec<usize> {
    let mut random = fastrand::Rng::with_seed(seed);
    let mut pattern = Pattern::new();
    let first = PIXELS / 10;
    let mut placed = 0;
    while placed < first {
        let at = random.usize(..PIXELS);
        if !pattern.set[at] {
            pattern.put(at, true);
            placed += 1;
        }
    }
    // The tightest cluster moves to the largest void until it would move back.
    loop {
        let cluster = pattern.cluster();
        pattern.put(cluster, false);
        let void = pattern.void();
        pattern.put(void, true);
        if void == cluster {
            break;
        }
    }
    let mut ranks = vec![0; PIXELS];
    let start = pattern.set.clone();
    for rank in (0..first).rev() {
        let cluster = pattern.cluster();
        pattern.put(cluster, false);
        ranks[cluster] = rank;
    }
    let mut pattern = Pattern::new();
    for at in (0..PIXELS).filter(|at| start[*at]) {
        pattern.put(at, true);
    }
    // Beyond half of the pixels the largest void of set pixels is the tightest cluster of empty ones: their energies add up
    // to a constant.
    for rank in first..PIXELS {
        let void = pattern.void();
        pattern.put(void, true);
        ranks[void] = rank;
    }
    ranks
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let path = std::env::args().nth(1).ok_or("which file to write?")?;
    let masks = [1, 2, 3].map(void_and_cluster);
    let picture = image::RgbImage::from_fn(SIZE as u32, SIZE as u32, |x, y| {
        let at = y as usize * SIZE + x as usize;
        image::Rgb([0, 1, 2].map(|channel| (masks[channel][at] * 256 / PIXELS) as u8))
    });
    picture.save(path)?;
    Ok(())
}
