//! Vectors that are mostly zero.

/// A vector that is mostly zero.
#[derive(Debug)]
pub(super) struct Sparse {
    pub values: Vec<f64>,
    /// Which entries may not be zero, and a list of them.
    is_touched: Vec<bool>,
    pub touched: Vec<u32>,
}

impl Sparse {
    pub fn new(len: usize) -> Self {
        Self {
            values: vec![0.0; len],
            is_touched: vec![false; len],
            touched: Vec::new(),
        }
    }

    #[inline]
    pub fn add(&mut self, i: usize, x: f64) {
        if !std::mem::replace(&mut self.is_touched[i], true) {
            self.touched.push(i as u32);
        }
        self.values[i] += x;
    }

    /// Its entries that may not be zero. It is zero afterwards.
    pub fn drain(&mut self) -> impl Iterator<Item = (usize, f64)> {
        self.touched.drain(..).map(|i| {
            let i = i as usize;
            self.is_touched[i] = false;
            (i, std::mem::take(&mut self.values[i]))
        })
    }

    pub fn clear(&mut self) {
        self.drain().for_each(drop);
    }
}
