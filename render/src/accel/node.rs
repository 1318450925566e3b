//! Nodes of eight children.

use obvhs::aabb::Aabb;

/// Children of a node.
pub(super) const NODE_WIDTH: usize = 8;

/// What a child is, and its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Child(u32);

/// A [`Child`], read.
pub(super) enum Kind {
    /// A node.
    Inner(usize),
    /// A block, and how many primitives it has.
    Block(usize, usize),
    /// A curved primitive.
    Curved(usize),
    /// An empty place, which no ray enters.
    Nothing,
}

impl Child {
    pub const NOTHING: Self = Self(u32::MAX);
    const LEAF: u32 = 1 << 31;
    const CURVED: u32 = 1 << 30;
    /// Indices are below, also those of nodes.
    const COUNT_SHIFT: u32 = 27;
    const INDEX: u32 = (1 << Self::COUNT_SHIFT) - 1;

    /// The root.
    pub const ROOT: Self = Self(0);

    /// Indices of nodes, blocks and curved primitives are below this; larger ones are wrong, so that who makes a tree counts
    /// them.
    pub const MANY: usize = Self::INDEX as usize;

    /// A node.
    pub fn inner(index: usize) -> Self {
        Self(index as u32 & Self::INDEX)
    }

    /// A block of so many primitives, one to eight.
    pub fn block(index: usize, count: usize) -> Self {
        let count = (count as u32 - 1) << Self::COUNT_SHIFT;
        Self(Self::LEAF | count | (index as u32 & Self::INDEX))
    }

    /// A curved primitive.
    pub fn curved(index: usize) -> Self {
        Self(Self::LEAF | Self::CURVED | (index as u32 & Self::INDEX))
    }

    /// The same where there are so many more of its kind before.
    pub fn behind(self, nodes: usize, leaves: usize, curved: usize) -> Self {
        let Self(code) = self;
        let by = match self.kind() {
            Kind::Inner(_) => nodes,
            Kind::Block(..) => leaves,
            Kind::Curved(_) => curved,
            Kind::Nothing => return self,
        };
        let index = (code & Self::INDEX).wrapping_add(by as u32) & Self::INDEX;
        Self(code & !Self::INDEX | index)
    }

    /// Whether it is nothing: so are those after it.
    #[inline(always)]
    pub fn is_nothing(self) -> bool {
        self == Self::NOTHING
    }

    #[inline(always)]
    pub fn kind(self) -> Kind {
        let Self(code) = self;
        let index = (code & Self::INDEX) as usize;
        if code & Self::LEAF == 0 {
            Kind::Inner(code as usize)
        } else if self == Self::NOTHING {
            Kind::Nothing
        } else if code & Self::CURVED != 0 {
            Kind::Curved(index)
        } else {
            let count = (code >> Self::COUNT_SHIFT & 7) as usize + 1;
            Kind::Block(index, count)
        }
    }
}

/// Boxes of eight children, relative to the centre of the tree.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Node {
    /// Per axis: lower planes, upper planes.
    pub planes: [[[f32; NODE_WIDTH]; 2]; 3],
    pub children: [Child; NODE_WIDTH],
}

impl Node {
    pub const EMPTY: Self = Self {
        // Entered by no ray from either side.
        planes: [[[f32::INFINITY; NODE_WIDTH], [f32::NEG_INFINITY; NODE_WIDTH]]; 3],
        children: [Child::NOTHING; NODE_WIDTH],
    };
}

impl Node {
    /// Writes the box of child `k`, relative to the centre of the tree.
    pub fn place(&mut self, k: usize, bounds: &Aabb, center: [f32; 3]) {
        let (low, high) = (bounds.min.to_array(), bounds.max.to_array());
        for axis in 0..3 {
            let [lower, upper] = &mut self.planes[axis];
            // An empty box is entered by no ray from either side.
            let empty = low[axis] > high[axis];
            lower[k] = if empty {
                f32::INFINITY
            } else {
                (low[axis] - center[axis]).next_down()
            };
            upper[k] = if empty {
                f32::NEG_INFINITY
            } else {
                (high[axis] - center[axis]).next_up()
            };
        }
    }
}
