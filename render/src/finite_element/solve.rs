//! Fields over elements and directions, and their transport over links.
//!
//! Everything here takes radiance and importance alike. A field is what leaves the elements; links turn
//! it into what arrives ([`Operator::incident`], forwards for radiance, over the same links backwards for
//! importance), and reflection ([`Operator::reflect`], symmetric) turns that into what leaves.

use std::ops::Range;

use rayon::prelude::*;

use super::FiniteElementError;
use super::basis::Spread;
use super::element::{Kind, Mesh};
use super::link::Link;

/// One number per channel.
pub type Colour = [f64; 3];

/// Which way links are followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    /// From source to receiver.
    Radiance,
    /// From receiver to source.
    Importance,
}

/// How a side reflects: `values[to * nodes + from]` is the BRDF between two nodes, sr^-1.
#[derive(Clone, Debug)]
pub struct Table {
    /// Number of nodes.
    pub nodes: usize,
    /// The BRDF, symmetric.
    pub values: Vec<Colour>,
    /// Largest fraction reflected.
    pub albedo: Colour,
    /// By how much the reflected distributions of two directions differ, as a fraction of what arrives.
    pub distance: Vec<f32>,
}

/// Field values of all elements: those of element `e` at `mesh.start[e]..mesh.start[e + 1]`.
pub type Field = Vec<Colour>;

/// The discretised transport operator.
#[derive(Clone, Copy, Debug)]
pub struct Operator<'a> {
    /// Elements.
    pub mesh: &'a Mesh,
    /// Links, ordered by receiver.
    pub links: &'a [Link],
    /// Links by receiver and by source.
    pub order: &'a Order,
    /// One table per side.
    pub tables: &'a [Table],
}

/// Which links begin or end at an element.
#[derive(Clone, Debug, Default)]
pub struct Order {
    by_receiver: Vec<u32>,
    by_source: Vec<u32>,
    source_links: Vec<u32>,
}

impl Order {
    /// Of links that are ordered by receiver.
    pub fn new(links: &[Link], elements: usize) -> Self {
        let starts = |end: &dyn Fn(&Link) -> u32| {
            let mut count = vec![0u32; elements + 1];
            for l in links {
                count[end(l) as usize + 1] += 1;
            }
            for i in 0..elements {
                count[i + 1] += count[i];
            }
            count
        };
        let by_source = starts(&|l| l.source);
        let mut next = by_source.clone();
        let mut source_links = vec![0; links.len()];
        for (i, l) in links.iter().enumerate() {
            let at = &mut next[l.source as usize];
            source_links[*at as usize] = i as u32;
            *at += 1;
        }
        Self {
            by_receiver: starts(&|l| l.receiver),
            by_source,
            source_links,
        }
    }

    /// The links that end at an element.
    pub fn received(&self, e: u32) -> Range<usize> {
        self.by_receiver[e as usize] as usize..self.by_receiver[e as usize + 1] as usize
    }
}

/// The values of every element as a slice of its own.
fn split<'a>(mesh: &Mesh, mut values: &'a mut [Colour]) -> Vec<&'a mut [Colour]> {
    let mut parts = Vec::with_capacity(mesh.elements.len());
    for w in mesh.start.windows(2) {
        let (part, rest) = values.split_at_mut(w[1] - w[0]);
        parts.push(part);
        values = rest;
    }
    parts
}

impl Operator<'_> {
    fn range(&self, e: u32) -> Range<usize> {
        self.mesh.start[e as usize]..self.mesh.start[e as usize + 1]
    }

    /// What arrives over the links at each element and direction, integrated over its area.
    pub fn incident(&self, leaving: &Field, flow: Flow) -> Field {
        let mut field = vec![[0.0; 3]; leaving.len()];
        let take = |values: &mut [Colour], to: &Spread, from: u32, send: &Spread, g: f64| {
            let l = send.read(&leaving[self.range(from)]);
            to.add(values, l.map(|l| l * g));
        };
        let parts = split(self.mesh, &mut field);
        parts
            .into_par_iter()
            .enumerate()
            .for_each(|(e, values)| match flow {
                Flow::Radiance => {
                    for l in &self.links[self.order.received(e as u32)] {
                        take(values, &l.receive, l.source, &l.send, l.coupling);
                    }
                }
                Flow::Importance => {
                    let sent = &self.order.by_source;
                    for &i in &self.order.source_links[sent[e] as usize..sent[e + 1] as usize] {
                        let l = &self.links[i as usize];
                        take(values, &l.send, l.receiver, &l.receive, l.coupling);
                    }
                }
            });
        field
    }

    /// What each element reflects of what arrives at itself, before levels are combined.
    pub fn reflect(&self, incident: &Field) -> Field {
        self.apply(incident, self.tables)
    }

    /// [`Operator::reflect`] with other tables.
    pub fn apply(&self, incident: &Field, tables: &[Table]) -> Field {
        let mut field = vec![[0.0; 3]; incident.len()];
        let parts = split(self.mesh, &mut field);
        parts.into_par_iter().enumerate().for_each(|(e, values)| {
            let Kind::Surface(table) = self.mesh.root(e as u32).kind else {
                return;
            };
            let arriving = &incident[self.range(e as u32)];
            let scale = 1.0 / self.mesh.elements[e].area;
            let n = values.len();
            for (from, a) in arriving.iter().enumerate() {
                if *a == [0.0; 3] {
                    continue;
                }
                let a = a.map(|a| a * scale);
                // The table is symmetric: the row serves as the column.
                let row = &tables[table].values[from * n..(from + 1) * n];
                for (v, f) in values.iter_mut().zip(row) {
                    for c in 0..3 {
                        v[c] += f[c] * a[c];
                    }
                }
            }
        });
        field
    }

    /// The whole radiance that leaves elements: their own, that of the elements they are part of, and the
    /// mean of their parts' [Hanrahan et al. 1991].
    pub fn push_pull(&self, own: &Field) -> Field {
        let mut up = own.clone();
        for e in (0..self.mesh.elements.len()).rev() {
            if let Some(parent) = self.mesh.elements[e].parent {
                let (to, from) = (self.range(parent), self.range(e as u32));
                // Parents come first.
                let (head, tail) = up.split_at_mut(from.start);
                for (t, f) in head[to].iter_mut().zip(&tail[..from.len()]) {
                    for c in 0..3 {
                        t[c] += 0.25 * f[c];
                    }
                }
            }
        }
        let mut down = vec![[0.0; 3]; own.len()];
        for e in 0..self.mesh.elements.len() {
            if let Some(parent) = self.mesh.elements[e].parent {
                for (i, j) in self.range(e as u32).zip(self.range(parent)) {
                    for c in 0..3 {
                        down[i][c] = down[j][c] + own[j][c];
                        up[i][c] += down[i][c];
                    }
                }
            }
        }
        up
    }

    /// Solves `x = P (own + R G x)` by iteration from `start`, until successive fields differ by less
    /// than `tolerance` of the largest value.
    ///
    /// # Errors
    /// More light after each bounce than before, or a non-finite source.
    pub fn solve(
        &self,
        own: &Field,
        flow: Flow,
        start: &Field,
        tolerance: f64,
    ) -> Result<Field, FiniteElementError> {
        const MOST: usize = 2000;
        let mut x = start.clone();
        let mut change = f64::INFINITY;
        for _ in 0..MOST {
            let mut source = self.reflect(&self.incident(&x, flow));
            for (s, o) in source.iter_mut().zip(own) {
                for c in 0..3 {
                    s[c] += o[c];
                }
            }
            let next = self.push_pull(&source);
            let (mut difference, mut largest): (f64, f64) = (0.0, 0.0);
            for (a, b) in next.iter().flatten().zip(x.iter().flatten()) {
                difference = difference.max((a - b).abs());
                largest = largest.max(a.abs());
                // max() ignores NaN.
                if !a.is_finite() {
                    return Err(FiniteElementError::Diverges { change: f64::NAN });
                }
            }
            x = next;
            if difference <= tolerance * largest {
                return Ok(x);
            }
            change = difference / largest;
        }
        Err(FiniteElementError::Diverges { change })
    }
}

/// The inner product of two fields, in a fixed order.
pub fn dot(a: &Field, b: &Field) -> f64 {
    a.iter()
        .zip(b)
        .map(|(a, b)| (0..3).map(|c| a[c] * b[c]).sum::<f64>())
        .sum()
}
