//! Marks: setting, listing, going to one, removing one.

use super::comparison::boiler;
use super::{one_line, snapshot};
use crate::common::harness::Stage;
use descan::app::{MAX_MARKS, Moment, Overlay, TimelineKind};

fn letters(stage: &Stage) -> String {
    stage.app.marks().by_letter().iter().map(|mark| mark.letter).collect()
}

/// The second of a moment.
fn second(moment: Moment) -> u64 {
    moment.time.as_micros() / 1_000_000
}

/// Letters of the marks in the timeline as shown, in its order, and the number of other lines.
fn on_timeline(stage: &Stage) -> (String, usize) {
    let lines = stage.app.lines_shown();
    let shown = lines.iter().map(|key| &stage.app.story(*key).unwrap().steps()[0].entry);
    let (mut marks, mut others) = (String::new(), 0);
    for line in shown {
        match line.kind {
            TimelineKind::Mark(letter) => marks.push(letter),
            _ => others += 1,
        }
    }
    (marks, others)
}

#[test]
fn mark_is_a_line_of_the_timeline_with_its_letter() {
    let mut stage = Stage::boiler();
    stage.until(20.0).keys("M").text("before the spare").until(24.0);
    assert!(one_line(&stage.screen()).contains("mark: before the spare"), "{}", stage.screen());
    stage.keys("Enter").until(30.0).keys("M Enter 3");
    snapshot!("marks_on_timeline", stage);
    stage.keys("'");
    snapshot!("marks_80x24", stage);
    let marks = stage.app.marks().by_letter();
    assert_eq!(second(marks[0].moment), 20, "the moment of the key");
    stage.keys("Esc");
    assert!(matches!(stage.app.overlay(), Overlay::None));
}

#[test]
fn marks_set_while_frozen_stand_at_their_moments() {
    let mut stage = boiler();
    stage.until(35.0).keys("M Enter [ [ [");
    let moment = stage.app.past_moment().unwrap();
    let (_, others) = on_timeline(&stage);
    stage.keys("M").text("three back").keys("Enter");
    assert_eq!(on_timeline(&stage), ("b".to_owned(), others), "a is later");
    assert_eq!(stage.app.past_moment(), Some(moment), "the moment stays");
    let all: Vec<u64> = stage.app.timeline().entries().map(|line| line.number).collect();
    assert!(all.is_sorted_by(|one, other| one < other), "{all:?}");
    // From there to the events on both sides, and back to the mark.
    stage.keys("]");
    assert!(stage.app.past_moment().unwrap().time > moment.time);
    stage.keys("[");
    assert_eq!(stage.app.past_moment().map(|it| it.time), Some(moment.time));
    stage.keys("Esc Esc : a Enter");
    assert_eq!(stage.app.past_moment().map(second), Some(35));
    stage.keys("' b Enter");
    assert_eq!(stage.app.past_moment(), Some(moment));
    assert_eq!(on_timeline(&stage), ("b".to_owned(), others));
    stage.keys(":").text("c").keys("Enter");
    assert!(stage.screen().contains("c: not a mark"), "{}", stage.screen());
}

#[test]
fn removed_mark_leaves_its_letter_and_line() {
    let mut stage = Stage::boiler();
    stage.until(10.0).keys("'");
    assert!(stage.screen().contains("no marks yet; M marks"), "{}", stage.screen());
    for seconds in [11.0, 12.0, 13.0] {
        stage.until(seconds).keys("M Enter");
    }
    stage.keys("' Up D");
    assert_eq!((letters(&stage), on_timeline(&stage).0), ("ac".to_owned(), "ac".to_owned()));
    // The next one takes the free letter, and is the last one all the same.
    stage.keys("Esc").until(14.0).keys("M Enter '");
    assert!(matches!(stage.app.overlay(), Overlay::Marks('b')));
    stage.keys("Delete Delete Delete");
    assert!(letters(&stage).is_empty() && matches!(stage.app.overlay(), Overlay::None));
    assert!(on_timeline(&stage).0.is_empty());
}

#[test]
fn marks_are_at_most_one_for_each_letter() {
    let mut stage = Stage::boiler();
    for number in 0..=MAX_MARKS {
        stage.until(number as f64 / 4.0).keys("M Enter");
    }
    assert_eq!(letters(&stage), ('a'..='z').collect::<String>());
    stage.keys("M");
    let screen = stage.screen();
    assert!(screen.contains("all 26 marks are set; remove one: '"), "{screen}");
    // Letters that are keys elsewhere choose their marks.
    for letter in ["j", "k", "q", "d"] {
        stage.keys("'").keys(letter);
        let is_chosen =
            matches!(stage.app.overlay(), Overlay::Marks(it) if it.to_string() == letter);
        assert!(is_chosen, "{letter}");
        stage.keys("Esc");
    }
}
