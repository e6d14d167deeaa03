//! Work shared by a few threads.

use std::sync::atomic::{AtomicUsize, Ordering};

/// The results of `work` for each of `0..count`, in this order, by up to `threads` threads. This one is among them, so
/// that nothing waits for another to begin, or for one that the system does not give; each begins with what `begin`
/// gives, and takes the next number when it is done with one.
///
/// # Panics
/// Where `begin` or `work` does.
pub fn share<S, T: Send>(
    count: usize,
    threads: usize,
    begin: impl Fn() -> S + Sync,
    work: impl Fn(&mut S, usize) -> T + Sync,
) -> Vec<T> {
    let next = AtomicUsize::new(0);
    let part = || {
        let mut state = begin();
        let mut done = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= count {
                return done;
            }
            done.push((number, work(&mut state, number)));
        }
    };
    let mut all = std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads.min(count))
            .filter_map(|_| std::thread::Builder::new().spawn_scoped(scope, part).ok())
            .collect();
        let mut all = part();
        for other in others {
            all.extend(other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        }
        all
    });
    all.sort_unstable_by_key(|(number, _)| *number);
    all.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::share;

    #[test]
    fn results_are_in_order_and_each_number_is_done_once() {
        for (count, threads) in [(0, 3), (1, 1), (1, 4), (7, 1), (7, 2), (300, 4), (5, 0)] {
            let done = std::sync::atomic::AtomicUsize::new(0);
            let results = share(
                count,
                threads,
                || 0,
                |mine: &mut usize, number| {
                    *mine += 1;
                    done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    number * number
                },
            );
            assert_eq!(results, (0..count).map(|number| number * number).collect::<Vec<_>>());
            assert_eq!(done.into_inner(), count);
        }
    }

    #[test]
    fn a_panic_of_any_thread_is_passed_on() {
        for bad in 0..8 {
            let caught = std::panic::catch_unwind(|| {
                share(8, 3, || (), |(), number| assert!(number != bad, "number {number}"))
            });
            assert!(caught.is_err(), "{bad}");
        }
    }
}
