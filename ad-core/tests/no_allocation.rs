//! No driver allocates; a chain allocates only until its buffer has grown once.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

use ad_core::{Chain, NewtonOptions, diff_fn, gradient, hessian, hvp, jvp, newton, vjp};

struct Counting;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: defers to the system allocator; the counter itself does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.with(|c| c.set(c.get() + 1));
        // SAFETY: the caller's contract is passed on.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        // SAFETY: the caller's contract is passed on.
        unsafe { System.dealloc(ptr, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

fn allocations(f: impl FnOnce()) -> usize {
    let before = COUNT.get();
    f();
    COUNT.get() - before
}

diff_fn! { fn smooth<R>([x, y]: [R; 2]) -> [R; 1] { [(x * y).sin() + x / y] } }
diff_fn! { fn system<R>([x, y]: [R; 2]) -> [R; 2] { [x * y - R::c(1.0), x - y] } }

#[test]
fn drivers_do_not_allocate() {
    let x = black_box([0.5f64, 0.7]);
    let count = allocations(|| {
        black_box(gradient(&smooth, x));
        black_box(hessian(&smooth, x));
        black_box(hvp(&smooth, x, [1.0, 2.0]));
        black_box(jvp(&system, x, [1.0, 2.0]));
        black_box(vjp(&system, x, [1.0, 2.0]));
        black_box(newton(&system, x, &NewtonOptions::default()));
    });
    assert_eq!(count, 0);
    assert_eq!(
        allocations(|| drop(black_box(vec![1u8]))),
        1,
        "the counter counts"
    );
}

#[test]
fn chains_reuse_their_buffer() {
    let mut chain = Chain::<f64, 2, 1>::new();
    let mut run = || {
        chain.start([0.3]);
        for _ in 0..1000 {
            chain.advance(&smooth, [0.9]);
        }
        black_box(chain.pull_back([1.0], |_, d: [f64; 1]| {
            black_box(d);
        }));
    };
    run();
    assert_eq!(allocations(run), 0);
}
