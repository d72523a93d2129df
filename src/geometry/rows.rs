//! Items sorted into the rows of a table without gaps, by counting.

/// The first item of each row with the end as one more number, and the items row by row, each row in
/// the order of `items`.
///
/// * `items`: each with its row; asked for twice.
pub fn in_rows<T, I>(rows: usize, items: impl Fn() -> I) -> (Vec<u32>, Vec<T>)
where
    T: Copy + Default,
    I: Iterator<Item = (u32, T)>,
{
    let mut start = vec![0u32; rows + 1];
    items().for_each(|(row, _)| start[row as usize + 1] += 1);
    for row in 0..rows {
        start[row + 1] += start[row];
    }
    let mut sorted = vec![T::default(); start[rows] as usize];
    // Filling moves each start to the next row's; shifting by one afterwards undoes that.
    for (row, item) in items() {
        let at = &mut start[row as usize];
        sorted[*at as usize] = item;
        *at += 1;
    }
    start.copy_within(0..rows, 1);
    start[0] = 0;
    (start, sorted)
}

#[cfg(test)]
mod tests {
    use super::in_rows;

    #[test]
    fn rows_hold_their_items_in_order() {
        let items = [(2, 'a'), (0, 'b'), (2, 'c'), (3, 'd'), (0, 'e')];
        let (start, sorted) = in_rows(5, || items.into_iter());
        assert_eq!(start, [0, 2, 2, 4, 5, 5]);
        assert_eq!(sorted, ['b', 'e', 'a', 'c', 'd']);
        assert_eq!(in_rows(0, std::iter::empty::<(u32, u8)>), (vec![0], vec![]));
    }
}
