//! Damaged input for everything that reads files: whatever the bytes, the answer is a scene or an error that can be
//! read, without a panic, in little memory.
//!
//! Inputs are made by code ([`corpus`]) and damaged by a few random changes ([`mutations`], [`apply`]) with fixed seeds,
//! so that a run is the same everywhere and takes seconds. The tests of this crate are the fuzzer.

pub mod corpus;
pub mod memory;

use proptest::prelude::*;
use proptest::test_runner::RngSeed;

/// A change of a text or of bytes. Positions are fractions of the current length, in 1/65536.
#[derive(Debug, Clone)]
pub enum Mutation {
    /// Another byte.
    Replace {
        /// Where.
        at: u16,
        /// By what.
        byte: u8,
    },
    /// Another bit.
    Flip {
        /// Where.
        at: u16,
        /// Which bit.
        bit: u8,
    },
    /// The end cut off.
    Truncate {
        /// Where.
        at: u16,
    },
    /// A part left out.
    Remove {
        /// Where it starts.
        from: u16,
        /// How many bytes it has.
        length: u8,
    },
    /// A part repeated elsewhere.
    Duplicate {
        /// Where it starts.
        from: u16,
        /// How many bytes it has.
        length: u16,
        /// Where it is put.
        to: u16,
    },
    /// A piece that means something to the reader.
    Insert {
        /// Where.
        at: u16,
        /// Which of the pieces.
        piece: usize,
    },
}

/// From one to five changes, with so many pieces to insert.
pub fn mutations(pieces: usize) -> impl Strategy<Value = Vec<Mutation>> {
    use Mutation::*;
    let one = prop_oneof![
        (any::<u16>(), any::<u8>()).prop_map(|(at, byte)| Replace { at, byte }),
        (any::<u16>(), 0..8_u8).prop_map(|(at, bit)| Flip { at, bit }),
        any::<u16>().prop_map(|at| Truncate { at }),
        (any::<u16>(), any::<u8>()).prop_map(|(from, length)| Remove { from, length }),
        (any::<u16>(), 0..2000_u16, any::<u16>()).prop_map(|(from, length, to)| Duplicate {
            from,
            length,
            to
        }),
        (any::<u16>(), 0..pieces).prop_map(|(at, piece)| Insert { at, piece }),
    ];
    prop::collection::vec(one, 1..6)
}

/// `bytes` after some changes.
pub fn apply(bytes: &[u8], mutations: &[Mutation], pieces: &[&[u8]]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for mutation in mutations {
        apply_one(&mut bytes, mutation, pieces);
    }
    bytes
}

fn apply_one(bytes: &mut Vec<u8>, mutation: &Mutation, pieces: &[&[u8]]) {
    let length = bytes.len();
    let position = |at: u16| length * usize::from(at) / 65536;
    match *mutation {
        Mutation::Replace { at, byte } => {
            if let Some(b) = bytes.get_mut(position(at)) {
                *b = byte;
            }
        }
        Mutation::Flip { at, bit } => {
            if let Some(b) = bytes.get_mut(position(at)) {
                *b ^= 1 << bit;
            }
        }
        Mutation::Truncate { at } => bytes.truncate(position(at)),
        Mutation::Remove { from, length: n } => {
            let from = position(from);
            bytes.drain(from..(from + usize::from(n)).min(length));
        }
        Mutation::Duplicate {
            from,
            length: n,
            to,
        } => {
            let from = position(from);
            let chunk = bytes[from..(from + usize::from(n)).min(length)].to_vec();
            let to = position(to);
            bytes.splice(to..to, chunk);
        }
        Mutation::Insert { at, piece } => {
            let at = position(at);
            bytes.splice(at..at, pieces[piece].iter().copied());
        }
    }
}

/// So many cases from a fixed seed.
pub fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        rng_seed: RngSeed::Fixed(1),
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

/// Longest message in bytes that a person would read.
pub const LONGEST_MESSAGE: usize = 8000;

/// Checks that an error can be read.
///
/// # Panics
/// If it says nothing, or too much.
pub fn check_message(error: &dyn std::fmt::Display) {
    let message = error.to_string();
    assert!(
        (1..LONGEST_MESSAGE).contains(&message.len()),
        "{} bytes: {message:.500}",
        message.len()
    );
}
