;; Strings of the library (table J.9); same bytes as lfield/vm/reference/library_functions.py.
;;
;; $base is the address of the block, a string the index of a word in it. A function that creates a string writes
;; it at $top if it ends before $end and has at most $max_length characters, and returns its size in words. Where
;; Python would raise (null, a bad index, a full heap, too long), and in a few rare cases more, it returns 0 without
;; effect: the reference engine executes that instruction.
;;
;; The same holds for strings of over 1024 bytes: WebAssembly does not check the time, so no instruction may take
;; much longer than others.

(func $is_long (param $bytes i32) (result i32)
    (i32.gt_u (local.get $bytes) (i32.const 1024)))

;; FNV-1a of 64 bits over the bytes of a string, without its lowest two bits; -1 for null and long strings.
(func $str_hash (export "str_hash") (param $base i32) (param $index i64) (result i64)
    (local $address i32) (local $count i32) (local $found i64)
    (if (i64.eqz (local.get $index)) (then (return (i64.const -1))))
    (local.set $address (call $address (local.get $base) (local.get $index)))
    (local.set $count (i32.load offset=8 (local.get $address)))
    (if (call $is_long (local.get $count)) (then (return (i64.const -1))))
    (local.set $address (i32.add (local.get $address) (i32.const 16)))
    (local.set $found (i64.const 0xCBF29CE484222325))
    (block $done
        (loop $next
            (br_if $done (i32.eqz (local.get $count)))
            (local.set $found
                (i64.mul
                    (i64.xor (local.get $found) (i64.load8_u (local.get $address)))
                    (i64.const 0x100000001B3)))
            (local.set $address (i32.add (local.get $address) (i32.const 1)))
            (local.set $count (i32.sub (local.get $count) (i32.const 1)))
            (br $next)))
    (i64.shr_u (local.get $found) (i64.const 2)))

;; The number of characters in some bytes: those that are not UTF-8 continuation bytes.
(func $characters (param $address i32) (param $count i32) (result i32)
    (local $found i32) (local $word i64)
    (local.set $found (local.get $count))
    (block $done
        (loop $words
            (br_if $done (i32.lt_u (local.get $count) (i32.const 8)))
            (local.set $word (i64.load align=1 (local.get $address)))
            (local.set $found
                (i32.sub
                    (local.get $found)
                    (i32.wrap_i64
                        (i64.popcnt
                            (i64.and
                                (i64.and
                                    (local.get $word)
                                    (i64.const 0x8080808080808080))
                                (i64.xor
                                    (i64.shl (local.get $word) (i64.const 1))
                                    (i64.const -1)))))))
            (local.set $address (i32.add (local.get $address) (i32.const 8)))
            (local.set $count (i32.sub (local.get $count) (i32.const 8)))
            (br $words)))
    (block $done
        (loop $bytes
            (br_if $done (i32.eqz (local.get $count)))
            (local.set $found
                (i32.sub
                    (local.get $found)
                    (i32.eq
                        (i32.and (i32.load8_u (local.get $address)) (i32.const 0xC0))
                        (i32.const 0x80))))
            (local.set $address (i32.add (local.get $address) (i32.const 1)))
            (local.set $count (i32.sub (local.get $count) (i32.const 1)))
            (br $bytes)))
    (local.get $found))

;; The address after $count characters, which must exist.
(func $skip (param $address i32) (param $count i32) (result i32)
    (block $done
        (loop $next
            (br_if $done (i32.eqz (local.get $count)))
            (local.set $count (i32.sub (local.get $count) (i32.const 1)))
            (local.set $address
                (i32.add
                    (local.get $address)
                    (i32.add
                        (i32.const 1)
                        (i32.add
                            (i32.ge_u (i32.load8_u (local.get $address)) (i32.const 0xC0))
                            (i32.add
                                (i32.ge_u (i32.load8_u (local.get $address)) (i32.const 0xE0))
                                (i32.ge_u (i32.load8_u (local.get $address)) (i32.const 0xF0)))))))
            (br $next)))
    (local.get $address))

;; Writes the header of a string of that many bytes at $top, with 0 in its last word; its size, 0 if it does not fit.
(func $start_string (param $base i32) (param $top i64) (param $end i64) (param $bytes i32) (result i64)
    (local $words i64) (local $address i32)
    (local.set $words
        (i64.add
            (i64.const 2)
            (i64.shr_u (i64.add (i64.extend_i32_u (local.get $bytes)) (i64.const 7)) (i64.const 3))))
    (if (i64.gt_u (i64.add (local.get $top) (local.get $words)) (local.get $end))
        (then (return (i64.const 0))))
    (local.set $address (call $address (local.get $base) (local.get $top)))
    (i64.store
        (call $address (local.get $address) (i64.sub (local.get $words) (i64.const 1)))
        (i64.const 0))
    (i64.store (local.get $address) (i64.or (i64.const 3) (i64.shl (local.get $words) (i64.const 32))))
    (i64.store offset=8 (local.get $address) (i64.extend_i32_u (local.get $bytes)))
    (local.get $words))

(func $str_concat (export "str_concat")
    (param $base i32) (param $top i64) (param $end i64) (param $max_length i64)
    (param $left i64) (param $right i64)
    (result i64)
    (local $first i32) (local $second i32) (local $first_size i32) (local $second_size i32) (local $words i64)
    (local $destination i32)
    (if (i32.or (i64.eqz (local.get $left)) (i64.eqz (local.get $right)))
        (then (return (i64.const 0))))
    (local.set $first (call $address (local.get $base) (local.get $left)))
    (local.set $second (call $address (local.get $base) (local.get $right)))
    (local.set $first_size (i32.load offset=8 (local.get $first)))
    (local.set $second_size (i32.load offset=8 (local.get $second)))
    (if (call $is_long (i32.add (local.get $first_size) (local.get $second_size)))
        (then (return (i64.const 0))))
    ;; A string has at most as many characters as bytes. If this bound is too large, Python counts them.
    (if (i64.gt_u
            (i64.extend_i32_u (i32.add (local.get $first_size) (local.get $second_size)))
            (local.get $max_length))
        (then (return (i64.const 0))))
    (local.set $words
        (call $start_string (local.get $base) (local.get $top) (local.get $end)
            (i32.add (local.get $first_size) (local.get $second_size))))
    (if (i64.eqz (local.get $words)) (then (return (i64.const 0))))
    (local.set $destination (i32.add (call $address (local.get $base) (local.get $top)) (i32.const 16)))
    (call $move (local.get $destination) (i32.add (local.get $first) (i32.const 16)) (local.get $first_size))
    (call $move
        (i32.add (local.get $destination) (local.get $first_size))
        (i32.add (local.get $second) (i32.const 16))
        (local.get $second_size))
    (local.get $words))

;; The number of characters of a string; -1 for null, and for a long one.
(func $str_len (export "str_len") (param $base i32) (param $index i64) (result i64)
    (local $address i32)
    (if (i64.eqz (local.get $index)) (then (return (i64.const -1))))
    (local.set $address (call $address (local.get $base) (local.get $index)))
    (if (call $is_long (i32.load offset=8 (local.get $address))) (then (return (i64.const -1))))
    (i64.extend_i32_u
        (call $characters
            (i32.add (local.get $address) (i32.const 16))
            (i32.load offset=8 (local.get $address)))))

;; Compares two strings: -1, 0 or 1. The order of UTF-8 is that of the code points. 2 where both are
;; long.
(func $compare_strings (param $base i32) (param $left i64) (param $right i64) (result i32)
    (local $first i32) (local $second i32) (local $first_size i32) (local $second_size i32) (local $count i32)
    (local $a i64) (local $b i64)
    (local.set $first (call $address (local.get $base) (local.get $left)))
    (local.set $second (call $address (local.get $base) (local.get $right)))
    (local.set $first_size (i32.load offset=8 (local.get $first)))
    (local.set $second_size (i32.load offset=8 (local.get $second)))
    (local.set $first (i32.add (local.get $first) (i32.const 16)))
    (local.set $second (i32.add (local.get $second) (i32.const 16)))
    (local.set $count
        (select
            (local.get $first_size)
            (local.get $second_size)
            (i32.lt_u (local.get $first_size) (local.get $second_size))))
    (if (call $is_long (local.get $count)) (then (return (i32.const 2))))
    (block $words
        (loop $next
            (br_if $words (i32.lt_u (local.get $count) (i32.const 8)))
            (br_if $words
                (i64.ne (i64.load align=1 (local.get $first)) (i64.load align=1 (local.get $second))))
            (local.set $first (i32.add (local.get $first) (i32.const 8)))
            (local.set $second (i32.add (local.get $second) (i32.const 8)))
            (local.set $count (i32.sub (local.get $count) (i32.const 8)))
            (br $next)))
    (block $bytes
        (loop $next
            (br_if $bytes (i32.eqz (local.get $count)))
            (local.set $a (i64.load8_u (local.get $first)))
            (local.set $b (i64.load8_u (local.get $second)))
            (if (i64.ne (local.get $a) (local.get $b))
                (then
                    (return
                        (i32.sub
                            (i64.gt_u (local.get $a) (local.get $b))
                            (i64.lt_u (local.get $a) (local.get $b))))))
            (local.set $first (i32.add (local.get $first) (i32.const 1)))
            (local.set $second (i32.add (local.get $second) (i32.const 1)))
            (local.set $count (i32.sub (local.get $count) (i32.const 1)))
            (br $next)))
    (i32.sub
        (i32.gt_u (local.get $first_size) (local.get $second_size))
        (i32.lt_u (local.get $first_size) (local.get $second_size))))

;; Whether two strings are equal; null equals null only. 2 where they are long.
(func $str_equal (export "str_equal") (param $base i32) (param $left i64) (param $right i64) (result i32)
    (local $order i32)
    (if (i64.eq (local.get $left) (local.get $right)) (then (return (i32.const 1))))
    (if (i32.or (i64.eqz (local.get $left)) (i64.eqz (local.get $right)))
        (then (return (i32.const 0))))
    (if (i64.ne
            (i64.load offset=8 (call $address (local.get $base) (local.get $left)))
            (i64.load offset=8 (call $address (local.get $base) (local.get $right))))
        (then (return (i32.const 0))))
    (local.set $order (call $compare_strings (local.get $base) (local.get $left) (local.get $right)))
    (select
        (i32.const 2)
        (i32.eqz (local.get $order))
        (i32.eq (local.get $order) (i32.const 2))))

;; Compares two strings: -1, 0 or 1; 2 when one is null, which has no order, and when both are long.
(func $str_order (export "str_order") (param $base i32) (param $left i64) (param $right i64) (result i32)
    (if (i32.or (i64.eqz (local.get $left)) (i64.eqz (local.get $right)))
        (then (return (i32.const 2))))
    (call $compare_strings (local.get $base) (local.get $left) (local.get $right)))

(func $substring (export "substring")
    (param $base i32) (param $top i64) (param $end i64) (param $max_length i64)
    (param $index i64) (param $start i64) (param $stop i64)
    (result i64)
    (local $address i32) (local $bytes i32) (local $count i32) (local $from i32) (local $to i32) (local $words i64)
    (if (i64.eqz (local.get $index)) (then (return (i64.const 0))))
    (local.set $address (call $address (local.get $base) (local.get $index)))
    (local.set $bytes (i32.load offset=8 (local.get $address)))
    (if (call $is_long (local.get $bytes)) (then (return (i64.const 0))))
    (local.set $address (i32.add (local.get $address) (i32.const 16)))
    (local.set $count (call $characters (local.get $address) (local.get $bytes)))
    (if (i32.or
            (i64.gt_u (local.get $start) (local.get $stop))
            (i64.gt_u (local.get $stop) (i64.extend_i32_u (local.get $count))))
        (then (return (i64.const 0))))
    (if (i64.gt_u (i64.sub (local.get $stop) (local.get $start)) (local.get $max_length))
        (then (return (i64.const 0))))
    (if (i32.eq (local.get $count) (local.get $bytes))
        (then
            (local.set $from (i32.add (local.get $address) (i32.wrap_i64 (local.get $start))))
            (local.set $to (i32.add (local.get $address) (i32.wrap_i64 (local.get $stop)))))
        (else
            (local.set $from (call $skip (local.get $address) (i32.wrap_i64 (local.get $start))))
            (local.set $to
                (call $skip
                    (local.get $from)
                    (i32.wrap_i64 (i64.sub (local.get $stop) (local.get $start)))))))
    (local.set $bytes (i32.sub (local.get $to) (local.get $from)))
    (local.set $words
        (call $start_string (local.get $base) (local.get $top) (local.get $end) (local.get $bytes)))
    (if (i64.eqz (local.get $words)) (then (return (i64.const 0))))
    (call $move
        (i32.add (call $address (local.get $base) (local.get $top)) (i32.const 16))
        (local.get $from)
        (local.get $bytes))
    (local.get $words))

;; The index of the second string in the first, in characters; -1: none. -2 for null, and where this search, which
;; tries every position, could take long.
(func $index_of (export "index_of") (param $base i32) (param $index i64) (param $pattern_index i64) (result i64)
    (local $address i32) (local $text i32) (local $pattern i32) (local $bytes i32) (local $length i32)
    (local $last i32) (local $first i32) (local $same i32)
    (if (i32.or (i64.eqz (local.get $index)) (i64.eqz (local.get $pattern_index)))
        (then (return (i64.const -2))))
    (local.set $text (call $address (local.get $base) (local.get $index)))
    (local.set $pattern (call $address (local.get $base) (local.get $pattern_index)))
    (local.set $bytes (i32.load offset=8 (local.get $text)))
    (local.set $length (i32.load offset=8 (local.get $pattern)))
    (if (i32.eqz (local.get $length)) (then (return (i64.const 0))))
    (if (i32.gt_u (local.get $length) (local.get $bytes)) (then (return (i64.const -1))))
    (if (i64.gt_u
            (i64.mul (i64.extend_i32_u (local.get $length)) (i64.extend_i32_u (local.get $bytes)))
            (i64.const 4096))
        (then (return (i64.const -2))))
    (local.set $text (i32.add (local.get $text) (i32.const 16)))
    (local.set $pattern (i32.add (local.get $pattern) (i32.const 16)))
    (local.set $first (i32.load8_u (local.get $pattern)))
    (local.set $address (local.get $text))
    (local.set $last
        (i32.add (local.get $text) (i32.sub (local.get $bytes) (local.get $length))))
    (loop $next
        (if (i32.eq (i32.load8_u (local.get $address)) (local.get $first))
            (then
                (local.set $same (i32.const 1))
                (block $differs
                    (loop $compare
                        (if (i32.eq (local.get $same) (local.get $length))
                            (then
                                (return
                                    (i64.extend_i32_u
                                        (call $characters
                                            (local.get $text)
                                            (i32.sub (local.get $address) (local.get $text)))))))
                        (br_if $differs
                            (i32.ne
                                (i32.load8_u (i32.add (local.get $address) (local.get $same)))
                                (i32.load8_u (i32.add (local.get $pattern) (local.get $same)))))
                        (local.set $same (i32.add (local.get $same) (i32.const 1)))
                        (br $compare)))))
        (local.set $address (i32.add (local.get $address) (i32.const 1)))
        (br_if $next (i32.le_u (local.get $address) (local.get $last))))
    (i64.const -1))
