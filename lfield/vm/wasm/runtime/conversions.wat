;; Numbers and booleans as text, and integers from text (table J.9); same bytes as
;; lfield/vm/reference/library_functions.py. Functions that create a string follow strings.wat.

;; The number of decimal digits.
(func $digits (param $value i64) (result i32)
    (local $count i32)
    (loop $next
        (local.set $count (i32.add (local.get $count) (i32.const 1)))
        (br_if $next
            (i64.ne
                (local.tee $value (i64.div_u (local.get $value) (i64.const 10)))
                (i64.const 0))))
    (local.get $count))

(func $i2s (export "i2s")
    (param $base i32) (param $top i64) (param $end i64) (param $max_length i64) (param $value i64)
    (result i64)
    (local $negative i32) (local $bytes i32) (local $words i64) (local $address i32)
    (local.set $negative (i64.lt_s (local.get $value) (i64.const 0)))
    ;; The smallest number is its own negative, which is right without a sign.
    (if (local.get $negative)
        (then (local.set $value (i64.sub (i64.const 0) (local.get $value)))))
    (local.set $bytes (i32.add (call $digits (local.get $value)) (local.get $negative)))
    (if (i64.gt_u (i64.extend_i32_u (local.get $bytes)) (local.get $max_length))
        (then (return (i64.const 0))))
    (local.set $words
        (call $start_string (local.get $base) (local.get $top) (local.get $end) (local.get $bytes)))
    (if (i64.eqz (local.get $words)) (then (return (i64.const 0))))
    (local.set $address (i32.add (call $address (local.get $base) (local.get $top)) (i32.const 16)))
    (if (local.get $negative) (then (i32.store8 (local.get $address) (i32.const 45))))
    (local.set $address (i32.add (local.get $address) (local.get $bytes)))
    (loop $next
        (local.set $address (i32.sub (local.get $address) (i32.const 1)))
        (i32.store8 (local.get $address)
            (i32.add
                (i32.const 48)
                (i32.wrap_i64 (i64.rem_u (local.get $value) (i64.const 10)))))
        (br_if $next
            (i64.ne
                (local.tee $value (i64.div_u (local.get $value) (i64.const 10)))
                (i64.const 0))))
    (local.get $words))

(func $b2s (export "b2s")
    (param $base i32) (param $top i64) (param $end i64) (param $max_length i64) (param $value i64)
    (result i64)
    (local $bytes i32) (local $words i64)
    (local.set $bytes (i32.sub (i32.const 5) (i64.ne (local.get $value) (i64.const 0))))
    (if (i64.gt_u (i64.extend_i32_u (local.get $bytes)) (local.get $max_length))
        (then (return (i64.const 0))))
    (local.set $words
        (call $start_string (local.get $base) (local.get $top) (local.get $end) (local.get $bytes)))
    (if (i64.eqz (local.get $words)) (then (return (i64.const 0))))
    (i64.store offset=16 (call $address (local.get $base) (local.get $top))
        (select
            (i64.const 0x65757274)
            (i64.const 0x65736c6166)
            (i64.ne (local.get $value) (i64.const 0))))
    (local.get $words))

;; The number in a text, and 1; or 0 and 0 if it is not one, has blanks around it, or more than 18 digits.
(func $s2i (export "s2i") (param $base i32) (param $index i64) (result i64 i32)
    (local $address i32) (local $end i32) (local $sign i32) (local $digit i32) (local $value i64)
    (if (i64.eqz (local.get $index)) (then (return (i64.const 0) (i32.const 0))))
    (local.set $address (call $address (local.get $base) (local.get $index)))
    (local.set $end (i32.load offset=8 (local.get $address)))
    (local.set $address (i32.add (local.get $address) (i32.const 16)))
    (local.set $sign (i32.load8_u (local.get $address)))
    (block $none
        (br_if $none (i32.eqz (local.get $end)))
        (br_if $none (i32.gt_u (local.get $end) (i32.const 18)))
        (local.set $end (i32.add (local.get $address) (local.get $end)))
        (if (i32.or
                (i32.eq (local.get $sign) (i32.const 45))
                (i32.eq (local.get $sign) (i32.const 43)))
            (then (local.set $address (i32.add (local.get $address) (i32.const 1)))))
        (br_if $none (i32.eq (local.get $address) (local.get $end)))
        (loop $next
            (local.set $digit (i32.sub (i32.load8_u (local.get $address)) (i32.const 48)))
            (br_if $none (i32.gt_u (local.get $digit) (i32.const 9)))
            (local.set $value
                (i64.add
                    (i64.mul (local.get $value) (i64.const 10))
                    (i64.extend_i32_u (local.get $digit))))
            (local.set $address (i32.add (local.get $address) (i32.const 1)))
            (br_if $next (i32.lt_u (local.get $address) (local.get $end))))
        (return
            (select
                (i64.sub (i64.const 0) (local.get $value))
                (local.get $value)
                (i32.eq (local.get $sign) (i32.const 45)))
            (i32.const 1)))
    (i64.const 0)
    (i32.const 0))
