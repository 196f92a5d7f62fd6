//! A closed range of numbers that knows how to refuse what lies outside.

use std::fmt;

use crate::ValueError;

/// The numbers `min..=max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberRange {
    /// The smallest number allowed.
    pub min: f64,
    /// The largest number allowed.
    pub max: f64,
}

impl NumberRange {
    /// The range `min..=max`.
    pub const fn new(min: f64, max: f64) -> Self {
        Self { min, max }
    }

    /// Whether the number is one of the range. NaN never is.
    pub fn contains(&self, number: f64) -> bool {
        number >= self.min && number <= self.max
    }

    /// The number, if it is in the range.
    ///
    /// # Errors
    /// Names the pointer, the number and the range.
    pub fn check(&self, pointer: &str, number: f64) -> Result<f64, ValueError> {
        if self.contains(number) {
            Ok(number)
        } else {
            Err(ValueError::of_number(pointer, number, self.to_string()))
        }
    }

    /// The whole number, if it is in the range.
    ///
    /// # Errors
    /// Names the pointer, the number and the range.
    pub fn check_u32(&self, pointer: &str, number: u32) -> Result<u32, ValueError> {
        self.check(pointer, f64::from(number)).map(|_| number)
    }

    /// Three numbers, each in the range.
    ///
    /// # Errors
    /// Names the pointer of the first number outside, the number and the range.
    pub fn check_each(&self, pointer: &str, numbers: [f64; 3]) -> Result<[f64; 3], ValueError> {
        for (index, number) in numbers.into_iter().enumerate() {
            self.check(&format!("{pointer}/{index}"), number)?;
        }
        Ok(numbers)
    }
}

impl fmt::Display for NumberRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} to {}", self.min, self.max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ends_belong_to_the_range_and_nan_does_not() {
        let range = NumberRange::new(0.0, 1.0);
        assert!(range.contains(0.0) && range.contains(1.0));
        assert!(!range.contains(f64::NAN) && !range.contains(1.0 + f64::EPSILON));
        let error = range.check("/x", f64::INFINITY).expect_err("infinite");
        assert_eq!(error.to_string(), "/x is inf; allowed: 0 to 1");
    }
}
