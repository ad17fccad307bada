//! Random and damaged sources, object codes and specifications.

use takt_irl::{System, compile, fuzz};
use takt_tests::fuzz::{feed, feed_files, words};

const SPEC: &str = include_str!("../../../examples/irl/two.spc");
const SOURCE: &str = include_str!("../../../examples/irl/palletize.irl");

#[test]
fn random_sources_are_rejected_or_run() {
    let text = "program p ; var x , y : int ; begin x := 1 + ( 2 ) * y ; if x < 3 then else endif ; while do endwhile ; \
                for to step endfor ; repeat until move ptp lin circle mainjoint act_rob \"lwr\" par endpar seq endseq wait sec \
                signal event procedure function endproc endfct return exit case of when default endcase array [ 1 .. 3 ] \
                record endrecord . @ real pose endprogram ;";
    feed("irl_words", fuzz::source, &words(text), 5_000);
    feed_files("irl_source", fuzz::source, &[SOURCE.as_bytes()], 500);
}

#[test]
fn damaged_object_code_never_panics() {
    let program = compile(SOURCE, &System::parse(SPEC).unwrap(), SPEC).unwrap();
    let code = program.program.encode();
    feed_files("irl_code", fuzz::code, &[&code], 1_000);
}

#[test]
fn damaged_specifications_never_panic() {
    feed_files(
        "irl_specification",
        fuzz::specification,
        &[SPEC.as_bytes()],
        2_000,
    );
}
