//! Which columns of a level are known.

/// A rectangle of columns by their indices along x and z in the layer's drifting field; `max` is not part of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Columns {
    /// First.
    pub min: [i64; 2],
    /// One beyond the last.
    pub max: [i64; 2],
}

impl Columns {
    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.min[0] >= self.max[0] || self.min[1] >= self.max[1]
    }

    /// How many.
    #[must_use]
    pub fn count(&self) -> u64 {
        if self.is_empty() {
            return 0;
        }
        (self.max[0] - self.min[0]) as u64 * (self.max[1] - self.min[1]) as u64
    }

    /// Those of both.
    #[must_use]
    pub fn and(&self, other: &Self) -> Self {
        let mut both = *self;
        for axis in 0..2 {
            both.min[axis] = self.min[axis].max(other.min[axis]);
            both.max[axis] = self.max[axis].min(other.max[axis]);
        }
        both
    }

    /// The window of `columns` columns along each axis around a place, in columns; it moves by whole strips.
    #[must_use]
    pub fn window(center: [f64; 2], columns: i64, strip: i64) -> Self {
        let min = center.map(|at| {
            let strips = at / strip as f64 - 0.5 * (columns / strip) as f64;
            strips.round() as i64 * strip
        });
        Self {
            min,
            max: min.map(|first| first + columns),
        }
    }

    /// Forgets what lies outside a window, whose texels are to be used anew, and tells which strip is to be made next. `self`
    /// must grow by it ([`Self::grow`]) once it is made. None when the window is full.
    pub fn next_strip(&mut self, window: &Self, strip: i64) -> Option<Self> {
        *self = self.and(window);
        if self.is_empty() {
            // From the middle outwards, along the whole of z.
            let middle = (window.min[0] + window.max[0]) / (2 * strip) * strip;
            let middle = middle.clamp(window.min[0], window.max[0] - strip);
            *self = Self {
                min: [middle, window.min[1]],
                max: [middle, window.max[1]],
            };
        }
        for axis in 0..2 {
            let (below, above) = (
                self.min[axis] - window.min[axis],
                window.max[axis] - self.max[axis],
            );
            let mut next = *self;
            if above > 0 && above >= below {
                next.min[axis] = self.max[axis];
                next.max[axis] = self.max[axis] + strip.min(above);
                return Some(next);
            }
            if below > 0 {
                next.max[axis] = self.min[axis];
                next.min[axis] = self.min[axis] - strip.min(below);
                return Some(next);
            }
        }
        None
    }

    /// Takes a strip in that [`Self::next_strip`] has told.
    pub fn grow(&mut self, strip: &Self) {
        for axis in 0..2 {
            self.min[axis] = self.min[axis].min(strip.min[axis]);
            self.max[axis] = self.max[axis].max(strip.max[axis]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const COLUMNS: i64 = 128;
    const STRIP: i64 = 8;

    fn filled(known: &mut Columns, window: &Columns) -> u64 {
        let mut made = 0;
        while let Some(strip) = known.next_strip(window, STRIP) {
            made += strip.count();
            known.grow(&strip);
        }
        made
    }

    proptest! {
        #[test]
        fn a_window_is_filled_once_and_a_moved_one_by_what_enters(
            x in -1e6..1e6f64, z in -1e6..1e6f64, dx in -300.0..300.0f64, dz in -300.0..300.0f64
        ) {
            let first = Columns::window([x, z], COLUMNS, STRIP);
            prop_assert!((first.min[0] as f64 + 64.0 - x).abs() <= 0.5 * STRIP as f64 + 1e-6);
            let mut known = Columns::default();
            prop_assert_eq!(filled(&mut known, &first), (COLUMNS * COLUMNS) as u64);
            prop_assert_eq!(known, first);
            let second = Columns::window([x + dx, z + dz], COLUMNS, STRIP);
            let stays = first.and(&second);
            let entered = second.count() - stays.count();
            prop_assert_eq!(filled(&mut known, &second), entered);
            prop_assert_eq!(known, second);
        }

        #[test]
        fn a_strip_never_overwrites_what_is_known(
            dx in -120.0..120.0f64, dz in -120.0..120.0f64
        ) {
            let mut known = Columns::default();
            filled(&mut known, &Columns::window([0.0; 2], COLUMNS, STRIP));
            let window = Columns::window([dx, dz], COLUMNS, STRIP);
            while let Some(strip) = known.next_strip(&window, STRIP) {
                // Two columns share a texel where they are a whole period apart.
                let mut both = known;
                both.grow(&strip);
                prop_assert!((0..2).all(|axis| both.max[axis] - both.min[axis] <= COLUMNS));
                known.grow(&strip);
            }
        }
    }

    #[test]
    fn a_window_that_rests_needs_nothing() {
        let mut known = Columns::default();
        let window = Columns::window([3.0, -7.0], COLUMNS, STRIP);
        filled(&mut known, &window);
        assert_eq!(known.next_strip(&window, STRIP), None);
        let near = Columns::window([2.0, -7.5], COLUMNS, STRIP);
        assert_eq!(known.next_strip(&near, STRIP), None);
    }
}
